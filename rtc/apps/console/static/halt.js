// HALT: the button, the key, and what came of it. It waits for nothing else on the page.
import { links } from './links.js';
import { emit, post, seconds, state } from './store.js';

const OTHER_WAY_MS = 300; // without an answer on the socket the order is also sent as a request

const report = document.getElementById('halt-report');
const button = document.getElementById('halt');

export const halts = []; // for tests: what was ordered and found

function show(kind, head, detail) {
  report.className = kind;
  report.replaceChildren(Object.assign(document.createElement('b'), { textContent: head }),
    Object.assign(document.createElement('span'), { textContent: detail }));
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
  showResult(scope, result, tookS);
  emit('halted', result);
}

function showResult(scope, result, tookS) {
  if (result.error) return show('bad', 'HALT NOT SENT', `${result.error}. Use the emergency stop.`);
  if (result.declined) return show('bad', `nothing halted: ${scope}`, result.message);
  // From the key to the first decelerating tick: the way to the gateway and back is in it, so it is an upper bound.
  const reachedS = tookS - result.took_s + (result.latency_s ?? 0);
  const moving = result.moving.length ? `${result.moving.join(', ')} slow down` : 'no joint was moving; reached';
  const first = `${moving} after ${seconds(reachedS)}`;
  if (!result.confirmed) return show('bad', 'REST NOT CONFIRMED', `${first}; ${result.message}`);
  return show('good', 'REST CONFIRMED', `${first}; at rest after ${seconds(tookS - result.took_s + (result.rest_s ?? 0))}`);
}

export function typing(target) {
  return target instanceof Element && (target.closest('.cm-editor, input, textarea, select, [contenteditable=true]') !== null);
}

export function armHalt() {
  button.addEventListener('pointerdown', (event) => { event.preventDefault(); halt(); });
  button.addEventListener('keydown', (event) => { if (event.key === 'Enter') { event.preventDefault(); halt(); } });
  // Space is HALT wherever nothing is typed; buttons are pressed by Enter.
  window.addEventListener('keydown', (event) => {
    if (event.code !== 'Space' || typing(event.target)) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    if (!event.repeat) halt();
  }, { capture: true });
  window.addEventListener('keyup', (event) => {
    if (event.code === 'Space' && !typing(event.target)) event.preventDefault(); // a focused button would be pressed
  }, { capture: true });
  show('', 'ready', 'Space or the button');
}
