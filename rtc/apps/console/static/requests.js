// Requests to the operator: what is asked, how far it is, and the means to do it. One card per operated arm.
import { openGamepad } from './gamepad.js';
import { answers, hold, holding, release } from './operate.js';
import { gizmo, grip } from './scene.js';
import { submit } from './sentence.js';
import { element, emit, inOneLine, on, state } from './store.js';

const SPEEDS = { fine: [0.01, 0.08], normal: [0.04, 0.3] }; // m/s, rad/s
const AXES = ['x', 'y', 'z'], TURNS = ['roll', 'pitch', 'yaw'];
const KEYS = { w: [0, 1], s: [0, -1], a: [1, 1], d: [1, -1], r: [2, 1], f: [2, -1], u: [3, 1], j: [3, -1], h: [4, 1], k: [4, -1], y: [5, 1], i: [5, -1] };
const FORCE_N = 40, TORQUE_NM = 4; // full bars

let holder, cards = new Map(), speed = 'normal', frame = 'world';

export function openRequests(panel) {
  holder = panel;
  on('arms', update);
  on('answers', answered);
  on('rows', () => cards.forEach(showVerdict));
  on('status', offers);
  openGamepad({ speeds: () => SPEEDS[speed], frame: () => frame, arms: () => operated().map(([name]) => name) });
  on('held', () => { for (const card of cards.values()) card.box.classList.toggle('held', holding() === card.arm); });
  update();
}

const operated = () => Object.entries(state.arms).filter(([, arm]) => arm.operation);

function update() {
  const now = operated();
  const tab = document.getElementById('tab-requests');
  tab.textContent = now.length ? `Requests ${now.length}` : 'Requests';
  tab.classList.toggle('wanted', now.length > 0);
  const known = new Set(now.map(([name, arm]) => `${name} ${arm.primitive}`));
  for (const [key, card] of cards) if (!known.has(key)) { card.box.remove(); cards.delete(key); gizmo(null); }
  for (const [name, arm] of now) {
    const key = `${name} ${arm.primitive}`;
    if (!cards.has(key)) {
      const card = make(name, arm);
      cards.set(key, card);
      holder.append(card.box);
      gizmo(name, { hold: (want) => hold(name, want), release, speed: () => SPEEDS[speed] });
      emit('request', name);
    }
    fill(cards.get(key), arm);
  }
  const empty = holder.querySelector('.empty');
  if (now.length) empty?.remove();
  else if (!empty) holder.append(element('p', { class: 'empty' }, 'nothing is asked of the operator. GIVE RIGHT-ARM TO OPERATOR hands an arm over; VIA OPERATOR-INTERVENTION asks for each step.'));
}

// What has failed and waits for the operator: the sentence that asks for it, and the commands that are held.
function offers() {
  const now = state.status.surrenders ?? [], stamp = JSON.stringify([now, state.role]);
  if (holder.offered === stamp) return;
  holder.offered = stamp;
  for (const old of holder.querySelectorAll('.offer')) old.remove();
  holder.append(...now.map((one) => element('article', { class: 'request offer' },
    element('header', {}, element('b', {}, `${one.command} has failed: ${one.cause}`)),
    one.waiting.length ? element('p', { class: 'note' }, `held until then: ${one.waiting.join(', ')}`) : '',
    element('div', { class: 'answer' }, element('button', { class: 'primary', onclick: () => submit(one.sentence), disabled: state.role !== 'operator' }, one.sentence)))));
}

function bar(name) {
  const fillOf = element('i', {}), mark = element('u', {}), words = element('span', {});
  return { row: element('div', { class: 'gauge' }, element('label', {}, name), element('div', { class: 'way' }, fillOf, mark), words),
    set(value, most, text, bound) {
      fillOf.style.width = `${Math.min(100, (100 * value) / most)}%`;
      fillOf.className = bound == null ? '' : value <= bound ? 'good' : 'open';
      mark.hidden = bound == null;
      if (bound != null) mark.style.left = `${Math.min(100, (100 * bound) / most)}%`;
      words.textContent = text;
    } };
}

function twist(axis, sign) {
  const [linear, turn] = SPEEDS[speed];
  const values = [0, 0, 0, 0, 0, 0];
  values[axis] = sign * (axis < 3 ? linear : turn);
  return { twist: values, frame };
}

// A button that acts while it is held: by the pointer, or by Enter.
function holdButton(arm, label, want, title) {
  const button = element('button', { class: 'hold', title });
  button.append(label);
  button.addEventListener('pointerdown', (event) => { button.setPointerCapture(event.pointerId); hold(arm, want); });
  for (const name of ['pointerup', 'pointercancel', 'lostpointercapture', 'blur']) button.addEventListener(name, release);
  button.addEventListener('keydown', (event) => { if (event.key === 'Enter') { event.preventDefault(); if (!event.repeat) hold(arm, want); } });
  button.addEventListener('keyup', (event) => { if (event.key === 'Enter') release(); });
  button.addEventListener('contextmenu', (event) => event.preventDefault());
  return button;
}

function choice(options, now, take) {
  const select = element('select', {}, ...options.map((name) => element('option', { selected: name === now }, name)));
  select.addEventListener('change', () => take(select.value));
  return select;
}

function make(arm, sample) {
  const { operation } = sample;
  const off = bar('distance'), force = bar('force'), torque = bar('torque');
  const who = element('span', { class: 'who' }), note = element('p', { class: 'note', role: 'status' });
  const verdict = element('p', { class: 'note wrong verdict', role: 'alert' });
  const axis = (n, name) => element('div', { class: 'axis' },
    holdButton(arm, '−', () => twist(n, -1), `hold: ${name} backwards`), element('b', {}, name),
    holdButton(arm, '+', () => twist(n, 1), `hold: ${name} forwards`));
  const pad = element('div', { class: 'pad', tabindex: '0', 'aria-label': 'hold to move: W S x, A D y, R F z, U J roll, H K pitch, Y I yaw' },
    ...AXES.map((name, n) => axis(n, name)), ...TURNS.map((name, n) => axis(n + 3, name)));
  pad.addEventListener('keydown', (event) => {
    const found = KEYS[event.key.toLowerCase()];
    if (!found || event.target !== pad || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    if (!event.repeat) hold(arm, () => twist(...found));
  });
  pad.addEventListener('keyup', release);
  pad.addEventListener('blur', release);
  const tools = element('div', { class: 'tools' },
    operation.hand && holdButton(arm, 'open hand', () => ({ hand: 'open' }), 'hold: the hand opens'),
    operation.hand && holdButton(arm, 'close hand', () => ({ hand: 'close' }), 'hold: the hand closes'),
    operation.spindle && holdButton(arm, 'loosen', () => ({ turn: -1 }), 'hold: the spindle loosens'),
    operation.spindle && holdButton(arm, 'tighten', () => ({ turn: 1 }), 'hold: the spindle tightens'));
  const why = element('input', { placeholder: 'why not', 'aria-label': 'why it cannot be done' });
  const box = element('article', { class: 'request' },
    element('header', {}, element('b', {}, operation.request), who),
    picture(sample.camera),
    off.row, force.row, torque.row,
    element('div', { class: 'options' }, 'speed', choice(Object.keys(SPEEDS), speed, (value) => { speed = value; }),
      'axes', choice(['world', 'tool'], frame, (value) => { frame = value; }), 'gizmo', choice(['translate', 'rotate'], 'translate', (mode) => grip()?.mode(mode))),
    pad, tools, note,
    element('div', { class: 'answer' }, element('button', { class: 'primary', onclick: () => answer('DONE') }, 'DONE'), why,
      element('button', { onclick: () => answer(`CANNOT "${why.value.replaceAll('"', "'") || 'no reason given'}"`) }, 'CANNOT')), verdict);
  const card = { arm, box, off, force, torque, who, note, verdict, answered: '' };
  async function answer(sentence) {
    verdict.textContent = '';
    card.answered = await submit(sentence);
    showVerdict(card);
  }
  return card;
}

// Why the answer was not accepted: beside its button, because the list of commands is in another panel.
function showVerdict(card) {
  const outcome = state.rows.get(card.answered)?.outcome;
  if (outcome && outcome.kind !== 'succeeded') card.verdict.textContent = [outcome.message, inOneLine(outcome.refusal?.clears)].filter(Boolean).join(' — ');
}

// One picture, that of the camera which shows the arm best; a click takes another.
function picture(first) {
  const cameras = state.scene.cameras;
  if (!cameras.length) return '';
  const image = element('img', { alt: 'picture of the request', hidden: true });
  const why = element('p', { class: 'note' });
  image.addEventListener('load', () => { image.hidden = false; });
  const take = async (name) => {
    why.textContent = '';
    const answer = await fetch(`/picture/${name}`).catch(() => null);
    if (answer?.ok) { image.src = URL.createObjectURL(await answer.blob()); return; }
    image.hidden = true; // no picture of another camera, or of another time, in its place
    why.textContent = answer ? (await answer.json()).error : 'the console does not answer';
  };
  const named = cameras.includes(first) ? first : cameras[0];
  take(named);
  return element('div', { class: 'seen' }, image, why, element('div', {}, choice(cameras, named, take),
    element('button', { class: 'quiet', onclick: (event) => take(event.target.previousSibling.value) }, 'again')));
}

function fill(card, arm) {
  const { operation, wrench } = arm;
  const bounded = operation.off_m != null;
  card.off.row.hidden = !bounded;
  if (bounded) {
    const done = operation.done_m;
    card.off.set(operation.off_m, operation.radius_m, `${(1e3 * operation.off_m).toFixed(1)} mm${done == null ? '' : `, DONE within ${(1e3 * done).toFixed(0)} mm`}`, done);
  }
  const size = (values) => Math.hypot(...values);
  card.force.set(size(wrench.slice(0, 3)), FORCE_N, `${size(wrench.slice(0, 3)).toFixed(1)} N  (${wrench.slice(0, 3).map((n) => n.toFixed(1)).join(' ')})`);
  card.torque.set(size(wrench.slice(3)), TORQUE_NM, `${size(wrench.slice(3)).toFixed(1)} N.m`);
  card.who.textContent = operation.operator ? `moved by ${operation.operator}` : 'at rest';
  if (holding() === card.arm || operation.cut) card.note.textContent = answers[card.arm]?.refused || operation.cut || '';
}

function answered(arm) {
  for (const card of cards.values()) {
    const { refused, cut } = answers[arm];
    if (card.arm === arm && (refused || cut)) { card.note.textContent = refused || cut; card.note.classList.toggle('wrong', Boolean(refused)); }
  }
}
