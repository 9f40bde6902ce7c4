// The panels at the side: commands with their causes, facts, cameras, the system.
import { halt } from './halt.js';
import { openRequests } from './requests.js';
import { submit, write } from './sentence.js';
import { ageOf, element, emit, nowS, on, seconds, state } from './store.js';

const PANELS = [['commands', 'Commands'], ['requests', 'Requests'], ['world', 'World'], ['cameras', 'Cameras'], ['system', 'System']];
const panels = {};
let active = 'commands';

export function openPanels() {
  const tabs = document.getElementById('tabs'), holder = document.getElementById('panels');
  for (const [name, title] of PANELS) {
    panels[name] = element('div', { class: `panel ${name}`, role: 'tabpanel', id: `panel-${name}`, hidden: name !== active });
    tabs.append(element('button', { role: 'tab', id: `tab-${name}`, 'aria-selected': String(name === active),
      'aria-controls': `panel-${name}`, onclick: () => choose(name) }, title));
    holder.append(panels[name]);
  }
  tabs.addEventListener('keydown', (event) => {
    const by = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!by) return;
    const names = PANELS.map(([name]) => name);
    choose(names[(names.indexOf(active) + by + names.length) % names.length]);
    document.getElementById(`tab-${active}`).focus();
  });
  openWorld();
  openCameras();
  openRequests(panels.requests);
  on('request', () => choose('requests'));
  on('rows', commands);
  on('chosen', (show) => { if (show) choose('commands'); loadWhy(); commands(); });
  on('facts', world);
  on('moving', world);
  on('status', system);
  commands();
  world();
  system();
  setInterval(() => { if (active === 'world') world(); if (active === 'commands') running(); }, 1000);
}

export function choose(name) {
  active = name;
  for (const [one] of PANELS) {
    panels[one].hidden = one !== name;
    document.getElementById(`tab-${one}`).setAttribute('aria-selected', String(one === name));
  }
  emit('panel', name);
}

// --- commands ---

const WORD = { halt_not_confirmed: 'halt not confirmed', lost_subsystem: 'subsystem lost' };
const number = (command) => Number(command.slice(2));
let why = { command: '', lines: [] };
const cards = new Map();

async function loadWhy() {
  const command = state.chosen;
  if (!command) return;
  const found = await fetch(`/why/${command}`).then((answer) => answer.json()).catch(() => ({ error: 'no answer' }));
  if (state.chosen !== command) return;
  why = { command, lines: found.lines ?? [found.error ?? found.refusal?.message ?? ''] };
  commands();
}

function commands(change) {
  const holder = panels.commands;
  const rows = [...state.rows.values()].sort((a, b) => number(b.command) - number(a.command));
  if (change?.rows?.some((row) => row.command === state.chosen && row.outcome)) loadWhy();
  if (!rows.length) { holder.replaceChildren(element('p', { class: 'empty' }, 'no command yet: type a sentence below')); return; }
  holder.querySelector('.empty')?.remove();
  const live = new Set(rows.map((row) => row.command));
  for (const [name, card] of cards) if (!live.has(name)) { card.remove(); cards.delete(name); }
  rows.forEach((row, n) => {
    let card = cards.get(row.command);
    if (!card) { card = element('article', {}); cards.set(row.command, card); }
    const stamp = JSON.stringify([row.last_seq, row.text, row.outcome?.kind, row.performers, state.chosen === row.command && why]);
    if (card.stamp !== stamp) { card.stamp = stamp; fill(card, row); }
    if (holder.children[n] !== card) holder.insertBefore(card, holder.children[n] ?? null);
  });
}

function fill(card, row) {
  const kind = row.outcome?.kind ?? row.phase, open = state.chosen === row.command;
  card.className = `card ${kind}${row.outcome ? '' : ' live'}${open ? ' open' : ''}`;
  const took = row.ended_at_s == null ? '' : seconds(row.ended_at_s - row.accepted_at_s);
  const head = element('button', { class: 'head', 'aria-expanded': String(open),
    onclick: () => { state.chosen = open ? '' : row.command; emit('chosen'); } },
  element('b', {}, row.command), element('span', { class: 'badge' }, WORD[kind] ?? kind), element('span', { class: 'took' }, took),
  element('code', {}, row.text || '…'));
  const trims = (row.marks ?? []).filter((mark) => mark.kind === 'trim').length;
  const step = element('div', { class: 'step' }, row.outcome ? row.outcome.message ?? '' : row.step || '',
    trims ? element('span', { class: 'trims' }, `${trims} trim${trims > 1 ? 's' : ''}`) : '');
  card.replaceChildren(head);
  if (step.textContent) card.append(step);
  if (!row.outcome) card.append(element('div', { class: 'progress' }, element('i', {})));
  if (open) card.append(actions(row), reasons(row));
}

function actions(row) {
  const say = (verb) => () => submit(`${verb} ${row.command}`);
  const able = state.role === 'operator';
  const live = row.outcome ? [] : [
    element('button', { onclick: () => halt(row.command), class: 'stop' }, 'Halt'),
    row.phase === 'paused'
      ? element('button', { onclick: say('RESUME'), disabled: !able }, 'Resume')
      : element('button', { onclick: say('PAUSE'), disabled: !able }, 'Pause'),
    element('button', { onclick: say('ABORT'), disabled: !able }, 'Abort')];
  const byOperator = row.outcome?.refusal?.detail?.by_operator;
  if (byOperator) live.push(element('button', { class: 'primary', onclick: () => submit(byOperator), disabled: !able, title: byOperator }, 'Ask the operator'));
  return element('div', { class: 'actions' }, ...live, element('button', { class: 'quiet', onclick: () => write(row.text) }, 'Edit again'));
}

function reasons(row) {
  const lines = why.command === row.command ? why.lines : ['…'];
  return element('ol', { class: 'why' }, ...lines.map((line) =>
    element('li', { class: line.startsWith('    ') ? 'inner' : '' }, line.trim())));
}

// The progress of steps whose duration is known.
function running() {
  const now = nowS();
  for (const row of state.rows.values()) {
    const bar = cards.get(row.command)?.querySelector('.progress i');
    if (!bar || row.outcome) continue;
    const span = (row.spans ?? []).at(-1);
    const part = span && span.to_s == null && span.expected_s ? (now - span.from_s) / span.expected_s : NaN;
    bar.className = Number.isFinite(part) ? '' : 'unknown';
    if (Number.isFinite(part)) bar.style.width = `${Math.min(100, 100 * part)}%`;
  }
}

// --- world ---

let filter = '';
let body;

function openWorld() {
  const input = element('input', { type: 'search', placeholder: 'filter: a name, an attribute, suspect …', 'aria-label': 'filter of facts' });
  input.addEventListener('input', () => { filter = input.value.toLowerCase(); world(); });
  body = element('div', { class: 'facts' });
  panels.world.append(input, body);
}

const factRows = new Map();

// The world database has the value before a motion; what a moving arm changes is shown as changing.
function validity(fact) {
  const [location, attribute] = [fact.key.slice(0, fact.key.lastIndexOf('.')), fact.key.slice(fact.key.lastIndexOf('.') + 1)];
  const holder = state.facts.get(`${location}.held_by`)?.value;
  const moves = (state.moving.includes(location) && attribute === 'joints')
    || (state.moving.includes(holder) && (attribute === 'frame' || attribute === 'seat'));
  return moves ? 'changing' : fact.validity;
}

function world() {
  const facts = [...state.facts.values()].sort((a, b) => (a.key < b.key ? -1 : 1));
  const shown = facts.filter((fact) => !filter || `${fact.key} ${validity(fact)} ${fact.source}`.toLowerCase().includes(filter));
  let location = '';
  const children = [];
  for (const fact of shown) {
    const dot = fact.key.lastIndexOf('.');
    if (fact.key.slice(0, dot) !== location) { location = fact.key.slice(0, dot); children.push(element('h3', {}, location)); }
    const valid = validity(fact);
    let row = factRows.get(fact.key);
    if (!row) {
      row = element('div', { class: 'fact' }, element('span', { class: 'key' }), element('span', { class: 'value' }),
        element('span', { class: 'validity' }), element('span', { class: 'age' }));
      factRows.set(fact.key, row);
    }
    const [key, value, validityCell, age] = row.children;
    key.textContent = fact.key.slice(dot + 1);
    value.textContent = fact.words;
    value.title = `${fact.words}\nby ${commandOf(fact.source)}`;
    validityCell.textContent = valid;
    validityCell.className = `validity ${valid}`;
    age.textContent = seconds(Math.max(0, ageOf(fact.at_s)));
    age.title = `by ${commandOf(fact.source)}`;
    children.push(row);
  }
  body.replaceChildren(...children, ...(shown.length ? [] : [element('p', { class: 'empty' }, 'no such fact')]));
}

// --- cameras ---

let live = false;

function openCameras() {
  const cameras = state.scene.cameras;
  if (!cameras.length) { panels.cameras.append(element('p', { class: 'empty' }, 'this cell has no camera')); return; }
  const toggle = element('input', { type: 'checkbox' });
  toggle.addEventListener('change', () => { live = toggle.checked; });
  const boxes = cameras.map((name) => {
    const image = element('img', { alt: `picture of ${name}`, hidden: true });
    const words = element('span', { class: 'words' }, 'no picture yet');
    const box = element('figure', {}, image, element('figcaption', {}, name, words));
    return { name, image, words, box, at: 0, busy: false };
  });
  panels.cameras.append(element('div', { class: 'bar' }, element('button', { onclick: () => boxes.forEach(take) }, 'Take pictures'),
    element('label', {}, toggle, 'again and again')), element('div', { class: 'pictures' }, ...boxes.map((one) => one.box)));
  on('panel', (name) => { if (name === 'cameras') boxes.forEach(take); });
  setInterval(() => {
    for (const one of boxes) {
      if (one.at) one.words.textContent = `${seconds((performance.now() - one.at) / 1000)} old`;
    }
    if (live && active === 'cameras' && !document.hidden) boxes.forEach(take);
  }, 1000);
}

async function take(one) {
  if (one.busy) return;
  one.busy = true;
  if (!one.at) one.words.textContent = 'is drawn …';
  try {
    const answer = await fetch(`/picture/${one.name}`);
    if (answer.ok) {
      URL.revokeObjectURL(one.image.src);
      one.image.src = URL.createObjectURL(await answer.blob());
      one.image.hidden = false;
      one.at = performance.now();
    } else one.words.textContent = (await answer.json()).error;
  } catch {
    one.words.textContent = 'the gateway does not answer';
  }
  one.busy = false;
}

// --- system ---

function table(columns, rows) {
  return element('table', {}, element('thead', {}, element('tr', {}, ...columns.map((name) => element('th', {}, name)))),
    element('tbody', {}, ...rows.map((cells) => element('tr', {}, ...cells.map((cell) => element('td', {}, cell))))));
}

function system() {
  const { processes = [], resources = [], subsystems = [], workers = [], queues = {}, counters = {}, halts = {} } = state.status;
  const busy = new Map(workers.map((one) => [one.name, one]));
  const counted = Object.entries(counters).filter(([, value]) => value);
  panels.system.replaceChildren(
    element('h3', {}, 'Resources'),
    resources.length ? table(['resource', 'owner', 'waiting'], resources.map((one) => [one.name, one.owner, one.waiting.join(', ')]))
      : element('p', { class: 'empty' }, 'all free'),
    element('h3', {}, 'Subsystems'),
    table(['name', 'state', 'performs', 'executes'], subsystems.map((one) => [one.name, mark(one.state), one.performers.join(', '), one.executing.map(commandOf).join(', ')])),
    element('h3', {}, 'Processes'),
    table(['name', 'state', 'restarts', 'busy with', 'done'], processes.filter((one) => !one.name.endsWith('template')).map((one) => [
      one.name, mark(one.state), String(one.restarts || ''), busy.get(one.name)?.busy_with ?? '', String(busy.get(one.name)?.done ?? '')])),
    element('h3', {}, 'Counters'),
    element('p', { class: 'plain' }, [...Object.entries(queues).filter(([, n]) => n).map(([name, n]) => `${n} jobs wait for a ${name}`),
      ...counted.map(([name, n]) => `${name} ${n}`), `${halts.called ?? 0} halts`].join(' · ')),
  );
}

// The command of a primitive (C-5.2@59ab) or of a job (C-5/7); other sources as they are.
const commandOf = (id) => id.match(/^C-\d+/)?.[0] ?? id;

function mark(word) {
  return element('span', { class: `validity ${['ready', 'connected'].includes(word) ? 'valid' : 'suspect'}` }, word);
}
