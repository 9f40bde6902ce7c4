// HALT: the button, the key, and what came of it. It waits for nothing else on the page.
import { links } from './links.js';
import { emit, on, post, seconds, state } from './store.js';

const OTHER_WAY_MS = 300; // without an answer on the socket the order is also sent as a request

const OLD_MS = 2000; // from this age on a result says how old it is

const report = document.getElementById('halt-report');
const button = document.getElementById('halt');
let shownAt = 0; // when the result was shown (ms); 0 while none is
let detail = '';

export const halts = []; // for tests: what was ordered and found

function show(kind, head, words, isResult = false) {
  shownAt = isResult ? performance.now() : 0;
  detail = words;
  report.className = kind;
  report.replaceChildren(Object.assign(document.createElement('b'), { textContent: head }),
    Object.assign(document.createElement('span'), { textContent: words }));
}

function showAge() {
  const oldMs = performance.now() - shownAt;
  if (shownAt && oldMs > OLD_MS) report.lastChild.textContent = `${detail} (${seconds(oldMs / 1000)} ago)`;
}

// What a halt has found says nothing of a motion that starts afterwards.
let moving = new Set();

function forgetAtStart() {
  const started = state.moving.some((name) => !moving.has(name));
  moving = new Set(state.moving);
  if (started && shownAt) show('', 'ready', '');
}

function sendAnotherWay(scope) {
  return post('/halt', { scope }).catch(() => ({ error: 'the gateway does not answer' }));
}

export async function halt(scope = 'ALL') {
  const calledMs = performance.now();
  emit('halting');
  const first = links.halt?.order(scope);
  show('sent', `HALT ${scope} sent`, 'waiting for rest');
  button.classList.add('pressed');
  const late = new Promise((done) => setTimeout(done, OTHER_WAY_MS));
  const second = first === undefined ? sendAnotherWay(scope) : late.then(() => state.links.halt ? first : sendAnotherWay(scope));
  const result = await Promise.race([first ?? second, second]);
  const tookS = (performance.now() - calledMs) / 1000;
  button.classList.remove('pressed');
  halts.push({ scope, result, tookS });
  emit('halted', { scope, result, tookS });
}

// A part of what was halted is at rest, and the rest is awaited.
function showRests({ name, rest_s: restS, awaited }) {
  show('sent', 'HALT ALL sent', `${name}: rest confirmed after ${seconds(restS)}; waiting for ${awaited.join(', ')}`);
}

function showResult({ scope, result, tookS }) {
  const of = scope.toUpperCase() === 'ALL' ? '' : `: ${scope}`;
  if (result.error) return show('bad', `HALT NOT SENT${of}`, `${result.error}. Use the emergency stop.`, true);
  if (result.declined) return show('bad', `nothing halted${of}`, result.message, true);
  // From the key to the first decelerating tick: the way to the gateway and back is in it, so it is an upper bound.
  const reachedS = tookS - result.took_s + (result.latency_s ?? 0);
  const moving = result.moving.length ? `${result.moving.join(', ')} slow down` : 'no joint was moving; reached';
  const all = result.unknown ? 'ALL was halted: nothing that moves has this name; ' : '';
  const first = `${all}${moving} after ${seconds(reachedS)}`;
  if (!result.confirmed) return show('bad', `REST NOT CONFIRMED${of}`, `${first}; ${result.message}`, true);
  return show('good', `REST CONFIRMED${of}`, `${first}; at rest after ${seconds(tookS - result.took_s + (result.rest_s ?? 0))}`, true);
}

// --- the key ---

const FIELD = '.cm-editor, input:not([type=checkbox]), textarea, [contenteditable=true]';

// Whether Space is a blank here: only where something is typed already. An empty field has no use for one.
export function typing(target) {
  const field = target instanceof Element ? target.closest(FIELD) : null;
  if (!field) return false;
  return (field.value ?? state.line).trim() !== '';
}

// The focus leaves the line and every other field: from now on Space is HALT.
export function leaveFields() {
  const active = document.activeElement;
  if (active instanceof HTMLElement && active.closest(`${FIELD}, select`)) active.blur();
  label();
}

function label() {
  const words = typing(document.activeElement) ? 'Esc Space' : 'Space';
  button.lastElementChild.textContent = state.role === 'observer' ? 'not by an observer' : words;
}

export function armHalt() {
  button.addEventListener('pointerdown', (event) => { event.preventDefault(); halt(); });
  button.addEventListener('keydown', (event) => { if (event.key === 'Enter') { event.preventDefault(); halt(); } });
  // Space is HALT wherever nothing is typed; buttons are pressed by Enter. Ctrl+Space lists words in the line.
  window.addEventListener('keydown', (event) => {
    if (event.code === 'Escape') return leaveFields();
    const lists = event.ctrlKey && event.target instanceof Element && event.target.closest('.cm-editor');
    if (event.code !== 'Space' || lists || typing(event.target)) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    if (!event.repeat) halt();
  }, { capture: true });
  window.addEventListener('keyup', (event) => {
    if (event.code === 'Space' && !typing(event.target)) event.preventDefault(); // a focused button would be pressed
  }, { capture: true });
  for (const name of ['focusin', 'focusout', 'input']) document.addEventListener(name, () => setTimeout(label));
  for (const name of ['line', 'links']) on(name, label);
  on('halted', showResult);
  on('rests', showRests);
  on('moving', forgetAtStart);
  setInterval(showAge, 500);
  show('', 'ready', '');
}
