// Start of the page: admission by the token of the link, then the sockets, the scene, the line and the panels.
import { armHalt, halt, halts, typing } from './halt.js';
import { links, openLinks } from './links.js';
import { answers, hold, holding, release, sent, watchHold } from './operate.js';
import { choose, openPanels } from './panels.js';
import { dress, grip, openScene, redraw, view } from './scene.js';
import { openLine, submit, tryOut, write } from './sentence.js';
import { ageOf, element, measuredAge, nowS, on, post, seconds, state } from './store.js';
import { openTracks } from './tracks.js';

const STALE_S = 1.5; // age of poses from which on the arms count as silent

async function admitted() {
  const token = location.hash.slice(1);
  if (token) {
    const answer = await post('/session', { token });
    history.replaceState(null, '', '/'); // the token does not stay in the address
    if (answer.error) return refuse(answer.error);
  }
  const me = await fetch('/me');
  if (!me.ok) return refuse((await me.json()).error);
  state.role = (await me.json()).role;
  return true;
}

function refuse(words) {
  document.querySelector('main').replaceChildren(element('div', { class: 'no-access' }, element('h1', {}, 'No access'), element('p', {}, words)));
  return false;
}

// --- the link: what is lost is said at once, and no picture is left that looks live ---

let lostAt = 0;

function watch() {
  const { poses, story, halt: halting } = state.links;
  const old = measuredAge();
  const lost = !poses || !story || !halting;
  const silent = !lost && (state.measuredAt === 0 || old > STALE_S + state.delayS);
  if (lost && !lostAt) lostAt = performance.now();
  if (!lost) lostAt = 0;
  if (Boolean(state.lost) !== lost) { state.lost = lost; redraw(); }
  const banner = document.getElementById('banner'), unknown = document.getElementById('unknown');
  banner.hidden = !lost;
  document.body.classList.toggle('lost', lost);
  if (lost) {
    const what = !poses && !story && !halting ? 'LINK LOST' : `LINK LOST IN PART: ${['poses', 'story', 'halt'].filter((name) => !state.links[name]).join(', ')}`;
    banner.textContent = `${what} since ${seconds((performance.now() - lostAt) / 1000)}. What happens now is unknown. `
      + (halting ? 'HALT still works.' : 'HALT from here may not arrive: use the emergency stop.');
  }
  unknown.hidden = !(lost || silent);
  unknown.textContent = lost ? 'unknown: the link is lost' : state.measuredAt
    ? `unknown: no measurement of the arms for ${seconds(old)}` : 'no measurement of the arms yet';
  chips(lost, silent, old);
}

function chips(lost, silent, old) {
  const statusAge = ageOf(state.statusAt);
  const chip = (name, good, words) => element('span', { class: `chip ${good ? 'good' : 'bad'}`, title: words }, element('i', {}), name);
  const arms = !lost && !silent;
  const subsystems = state.status.subsystems ?? [];
  document.getElementById('chips').replaceChildren(
    chip('link', !lost, lost ? 'the gateway does not answer' : `halt line ${links.halt?.wayMs?.toFixed(1)} ms`),
    chip('broker', statusAge < 6, state.statusAt ? `last status ${seconds(statusAge)} ago` : 'no status yet'),
    chip('arms', arms, state.measuredAt ? `measured ${seconds(Math.max(0, old))} ago` : 'not measured yet'),
    ...subsystems.filter((one) => one.state !== 'connected').map((one) => chip(one.name, false, one.state)),
    state.role === 'operator' ? '' : element('span', { class: 'chip' }, state.role),
  );
}

function themes() {
  const kept = localStorage.getItem('theme');
  if (kept) document.documentElement.dataset.theme = kept;
  document.getElementById('theme').addEventListener('click', () => {
    const dark = getComputedStyle(document.documentElement).getPropertyValue('--is-dark').trim() === '1';
    document.documentElement.dataset.theme = dark ? 'light' : 'dark';
    localStorage.setItem('theme', document.documentElement.dataset.theme);
    dress();
  });
  matchMedia('(prefers-color-scheme: dark)').addEventListener('change', dress);
}

async function start() {
  themes();
  armHalt();
  if (!(await admitted())) return;
  openLinks(); // first: HALT needs them and nothing else
  state.scene = await (await fetch('/scene')).json();
  document.getElementById('cell').textContent = state.scene.cell;
  document.title = `${state.scene.cell} – rtc console`;
  openScene(state.scene); // before the requests, which put a gizmo into it
  watchHold();
  openPanels();
  openTracks();
  openLine();
  on('links', watch);
  setInterval(watch, 200);
  watch();
}

// For tests and the curious: the state of the page and of its scene.
window.rtcConsole = { state, view, links, halts, halt, submit, tryOut, write, choose, nowS, typing, hold, holding, release, answers, sent, grip };

start();
