// Hold to move: a stream of twists to one arm while something is held, and nothing otherwise. It knows no request.
import { links } from './links.js';
import { emit, measuredAge, on, state } from './store.js';

const PERIOD_MS = 25; // the arm stops 60 ms after the latest message
const OLD_S = 0.5; // no one moves an arm by a picture that is older

let held = null; // {arm, want}: what is held now; `want()` gives twist, hand, turn
let timer = 0;

// What a subsystem has answered: arm -> {refused, cut}.
export const answers = {};
export const sent = { count: 0 };

function send(hold) {
  const { arm, grant, want } = held;
  // The grant is that of the beginning: a hold does not go over to the next request.
  const seen = Math.max(state.measuredAt, answers[arm]?.at_s ?? 0); // of the subsystem: the latest that has arrived
  const old = measuredAge();
  if (hold && !(old < OLD_S)) {
    emit('operated', { ...answers[arm], arm, refused: Number.isFinite(old) ? `the picture is ${old.toFixed(1)} s old` : 'no measurement of the arms yet', cut: '' });
    hold = false;
  }
  const message = { arm, primitive: grant, seen_at_s: seen, hold, ...(hold ? want() : {}) };
  sent.count += 1;
  links.operate.send(JSON.stringify(message));
}

export function hold(arm, want) {
  release();
  const grant = state.arms[arm]?.primitive;
  if (!grant) return;
  answers[arm] = { at_s: answers[arm]?.at_s ?? 0, refused: '', cut: '' };
  held = { arm, grant, want };
  send(true);
  timer = setInterval(() => send(true), PERIOD_MS);
  emit('held', arm);
}

export function release() {
  if (!held) return;
  clearInterval(timer);
  send(false);
  held = null;
  emit('held', '');
}

export const holding = () => held?.arm ?? '';

// Whatever takes the hand from the page lets go.
export function watchHold() {
  for (const name of ['blur', 'pagehide', 'pointerup', 'pointercancel']) window.addEventListener(name, release);
  document.addEventListener('visibilitychange', release);
  on('halting', release);
  on('links', () => { if (!state.links.operate) { clearInterval(timer); held = null; } });
  on('arms', () => { if (held && state.arms[held.arm]?.primitive !== held.grant) release(); });
  on('operated', (answer) => { answers[answer.arm] = answer; emit('answers', answer.arm); });
}
