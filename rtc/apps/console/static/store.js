// What the page knows, and the clock of the gateway. Modules listen to names of changes.

const listeners = new Map();

export const state = {
  scene: null, role: '', life: '', n: 0,
  rows: new Map(), // command -> row
  lines: [], // halts, refusals, reports
  arms: {}, facts: new Map(), status: {}, statusAt: 0, moving: [], prediction: null,
  chosen: '', // the command whose details are shown
  line: '', // what is typed in the sentence line
  links: { poses: false, story: false, halt: false, operate: false },
  measuredAt: 0, // when the shown poses were measured, by the clock of their subsystem (s)
  clockS: 0, // what that clock is behind the one of the gateway (s); other than 0 only over tcp
  delayS: 0, // of the link to the cluster, one way (s)
  frameAt: -Infinity, // when the last frame arrived, by performance.now (ms)
};

export function on(name, listener) {
  listeners.set(name, [...(listeners.get(name) ?? []), listener]);
}

export function emit(name, detail) {
  for (const listener of listeners.get(name) ?? []) listener(detail);
}

// --- the commands of this page, also of before it was loaded anew ---

const KEPT = 50;
const own = new Set(JSON.parse(sessionStorage.getItem('own') ?? '[]'));
let predictions = [];

export function takeOwn(command) {
  own.add(command);
  sessionStorage.setItem('own', JSON.stringify([...own].slice(-KEPT)));
  takePredictions(predictions);
}

export const isOwn = (command) => own.has(command);

// The last of this page; another page may have tested something else.
export function takePredictions(all) {
  predictions = all;
  const found = all.findLast((one) => own.has(one.command)) ?? null;
  if (found?.command === state.prediction?.command) return;
  // What a TEST does not change has poses that are no numbers.
  state.prediction = found && { ...found, poses: Float32Array.from(found.poses, (value) => value ?? NaN) };
  emit('prediction');
}

// What would clear a refusal, in one line, as `rtc.wording.advice` has it.
export const inOneLine = (clears) => (clears ?? []).map(({ sentences = [], words = '', again, instead }) => {
  const text = [...sentences, ...(again ? ['the same sentence again'] : [])].join(', then ');
  return text ? `${text}${instead ? ' instead' : ''}${words && ` (${words})`}` : words;
}).join('; or ');

// --- the clock of the gateway: the answer with the shortest way is the best estimate ---

const answers = [];

export function takeClock(sentMs, theirsS) {
  const now = performance.now();
  answers.push({ way: now - sentMs, offset: theirsS - (now + sentMs) / 2000 });
  if (answers.length > 20) answers.shift();
}

export function nowS() {
  if (!answers.length) return NaN;
  return performance.now() / 1000 + answers.reduce((a, b) => (b.way < a.way ? b : a)).offset;
}

// The age of what was measured or received at a time (s); no number before the first.
export const ageOf = (atS) => (atS ? nowS() - atS : NaN);

// The age of the shown poses (s).
export const measuredAge = () => ageOf(state.measuredAt) - state.clockS;

// --- for people ---

export function seconds(value) {
  if (!Number.isFinite(value)) return '–';
  if (value < 0.001) return `${(value * 1e3).toFixed(2)} ms`;
  if (value < 0.0995) return `${(value * 1e3).toFixed(value < 0.01 ? 1 : 0)} ms`;
  if (value < 60) return `${value.toFixed(value < 10 ? 1 : 0)} s`;
  if (value < 3600) return `${Math.floor(value / 60)} min ${Math.floor(value % 60)} s`;
  return `${Math.floor(value / 3600)} h ${Math.floor((value % 3600) / 60)} min`;
}

export function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name === 'class') made.className = value;
    else if (name.startsWith('on')) made.addEventListener(name.slice(2), value);
    else if (value !== false && value != null) made.setAttribute(name, value === true ? '' : value);
  }
  made.append(...children.filter((child) => child != null && child !== false));
  return made;
}

export async function post(path, body) {
  const answer = await fetch(path, {
    method: 'POST', headers: { 'Content-Type': 'application/json' }, body: JSON.stringify(body),
  });
  if (answer.status === 204) return {};
  try {
    return await answer.json();
  } catch {
    return { error: `the gateway answers with status ${answer.status}` };
  }
}
