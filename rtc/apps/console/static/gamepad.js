// Hold to move by a gamepad: the sticks command the arm of the request while a shoulder button is held.
import { hold, holding, release } from './operate.js';

const DEADMAN = [4, 5]; // left and right shoulder button of the standard mapping
const RAISE = 7, LOWER = 6, ROLL = [14, 15]; // triggers, and left and right of the cross
const REST = 0.12; // of a stick's way: nearer to the middle it says nothing

let taken = '', speeds = () => [0, 0], frame = () => 'world', arms = () => [];

const pad = () => [...navigator.getGamepads()].find((one) => one?.connected && one.mapping === 'standard');
const pressed = (one, n) => one.buttons[n]?.value ?? 0;
const stick = (value = 0) => (Math.abs(value) < REST ? 0 : value);

// x y z roll pitch yaw: forwards is away from the person, as on the left stick; the right stick turns.
function twist() {
  const one = pad();
  if (!one) return { twist: [0, 0, 0, 0, 0, 0], frame: frame() };
  const [sideways, back, turn, tilt] = one.axes.map(stick), [linear, angular] = speeds();
  const [left, right] = ROLL.map((n) => pressed(one, n));
  const along = [-back, -sideways, pressed(one, RAISE) - pressed(one, LOWER)], about = [right - left, tilt, -turn];
  return { twist: [...along.map((n) => n * linear), ...about.map((n) => n * angular)], frame: frame() };
}

function look() {
  const one = pad(), held = Boolean(one) && DEADMAN.some((n) => pressed(one, n) > 0.5);
  if (held && !taken && !holding() && arms().length) { [taken] = arms(); hold(taken, twist); }
  if (!held && taken) { taken = ''; release(); }
  if (one) requestAnimationFrame(look);
}

// `given`: the functions speeds, frame and arms, for what is chosen on the page.
export function openGamepad(given) {
  ({ speeds, frame, arms } = given);
  window.addEventListener('gamepadconnected', () => requestAnimationFrame(look));
  window.addEventListener('gamepaddisconnected', look);
}
