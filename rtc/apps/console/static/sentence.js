// The sentence line: completion, the error under its word, TEST and DO. Enter does, Shift+Enter tests, Tab completes.
import {
  acceptCompletion, autocompletion, closeCompletion, completionStatus, defaultKeymap, EditorState, EditorView, history,
  historyKeymap, keymap, moveCompletionSelection, placeholder, Prec, setDiagnostics, startCompletion,
} from './vendor.js';
import { leaveFields } from './halt.js';
import { element, emit, inOneLine, on, post, seconds, state, takeOwn } from './store.js';

const KEPT = 100; // sentences that the arrow keys bring back
const hint = document.getElementById('hint');
const tested = document.getElementById('tested');
let editor, checking = 0, shown = null, earlier = JSON.parse(sessionStorage.getItem('sentences') ?? '[]'), at = earlier.length;

export const text = () => editor.state.doc.toString();

// Replace what is typed; the focus stays where it is.
function put(sentence) {
  editor.dispatch({ changes: { from: 0, to: editor.state.doc.length, insert: sentence }, selection: { anchor: sentence.length } });
}

export function write(sentence) {
  put(sentence);
  editor.focus();
}

async function complete(context) {
  const word = context.matchBefore(/[\w%/-]*/);
  const found = await post('/check', { text: context.state.doc.toString(), at: context.pos }).catch(() => ({ offers: [] }));
  if (!found.offers?.length) return null;
  return { from: word.from, options: found.offers.map((label) => ({ label, apply: `${label} ` })), filter: false };
}

async function check() {
  const now = (checking += 1), sentence = text();
  if (sentence === shown) return; // why it was refused stays until it is changed
  shown = null;
  if (!sentence.trim()) { mark(null); say(''); return; }
  const found = await post('/check', { text: sentence, at: sentence.length }).catch(() => ({}));
  if (now !== checking || sentence !== text() || sentence === shown) return; // it has been typed on, or refused
  const refusal = found.refusal;
  if (!refusal) { mark(null); say('Enter: do it. Shift+Enter: test it on paper first.', 'fine'); return; }
  const open = refusal.column >= sentence.trimEnd().length;
  mark(open ? null : refusal);
  const next = (refusal.nearest?.length ? `Did you mean ${refusal.nearest.join(' or ')}?` : '')
    || expected(refusal.expected);
  if (open) say(next, 'next');
  else say(`${refusal.message} ${next}`, 'wrong', refusal.column);
}

function expected(words) {
  if (!words?.length) return '';
  return words.length > 14 ? `next: one of ${words.length} words; Ctrl+Space lists them` : `next: ${words.join(', ')}`;
}

function mark(refusal) {
  const length = editor.state.doc.length;
  let marks = [];
  if (refusal && refusal.column < length) {
    const rest = text().slice(refusal.column).match(/^\S+/)?.[0].length ?? 1;
    marks = [{ from: refusal.column, to: Math.min(length, refusal.column + rest), severity: 'error', message: refusal.message }];
  }
  editor.dispatch(setDiagnostics(editor.state, marks));
}

// The words stand below the place that they are about.
function say(words, kind = '', column = 0) {
  hint.textContent = words;
  hint.className = kind;
  const place = kind === 'wrong' ? editor.coordsAtPos(Math.min(column, editor.state.doc.length)) : null;
  const left = place ? place.left - hint.parentElement.getBoundingClientRect().left : 38;
  const room = hint.parentElement.clientWidth;
  hint.style.paddingLeft = `${Math.max(38, Math.min(left, room - 520))}px`;
}

// Returns the number of its command; empty if none was accepted. The focus is in no field then: Space is HALT.
export async function submit(sentence, about = {}) {
  const clean = sentence.trim();
  if (!clean) return '';
  closeCompletion(editor);
  leaveFields();
  if (tested.className === 'advice') tested.hidden = true;
  earlier = [...earlier.filter((one) => one !== clean), clean].slice(-KEPT);
  at = earlier.length;
  sessionStorage.setItem('sentences', JSON.stringify(earlier));
  say('sent …', 'next');
  const sentMs = performance.now();
  const answer = await post('/sentence', { text: clean, ...about }).catch(() => ({ error: 'the gateway does not answer: it was not sent' }));
  if (answer.command) {
    newest = state.chosen = answer.command;
    takeOwn(answer.command);
    typed.set(answer.command, text().trim() === clean ? clean : '');
    if (text().trim() === clean) put('');
    say(`${answer.command} accepted`, 'fine');
    emit('chosen');
    giveBackRefused(); // it may have ended before this answer
  } else if (answer.halt) {
    if (text().trim() === clean) put('');
    say('');
    emit('halted', { scope: answer.halt.scope ?? '', result: answer.halt, tookS: (performance.now() - sentMs) / 1000 });
  } else {
    const { message, clears } = answer.refusal ?? { message: answer.error };
    say([message, inOneLine(clears)].filter(Boolean).join(' — '), 'wrong');
  }
  return answer.command ?? '';
}

// A sentence of this page that is refused comes back into the line, to be mended.
const typed = new Map(); // command that has not ended -> the sentence that was taken out of the line

function giveBackRefused() {
  for (const [command, sentence] of typed) {
    const outcome = state.rows.get(command)?.outcome;
    if (!outcome) continue;
    typed.delete(command);
    offerAdvice(command, outcome);
    if (outcome.kind !== 'refused' || TEST.test(state.rows.get(command).text)) continue; // a TEST has its strip
    if (sentence && !text().trim()) put(sentence);
    const { message, clears } = outcome.refusal ?? { message: outcome.message };
    shown = text();
    say([`${command} refused: ${message}`, inOneLine(clears)].filter(Boolean).join(' — '), 'wrong');
  }
}

const TEST = /^\s*(TEST|SIMULATE)\b/i;
const testOf = (sentence) => (TEST.test(sentence) ? sentence : `TEST ${sentence.trim().replace(/\.$/, '')}`);

export async function test(sentence) {
  if (!sentence.trim()) return;
  const kept = sentence;
  await submit(testOf(sentence));
  if (!text()) put(kept); // the sentence stays, to be done next
}

function back(by) {
  at = Math.max(0, Math.min(earlier.length, at + by));
  write(earlier[at] ?? '');
}

const arrow = (by) => (view) => {
  if (completionStatus(view.state)) return moveCompletionSelection(by > 0)(view);
  back(by);
  return true;
};

export function openLine() {
  const nonce = document.querySelector('meta[name=csp-nonce]').content;
  editor = new EditorView({
    parent: document.getElementById('editor'),
    state: EditorState.create({
      extensions: [
        EditorView.cspNonce.of(nonce),
        EditorState.transactionFilter.of((change) => (change.newDoc.lines > 1 ? [] : change)),
        Prec.highest(keymap.of([
          { key: 'Enter', run: (view) => { closeCompletion(view); submit(text()); return true; } },
          { key: 'Shift-Enter', run: (view) => { closeCompletion(view); test(text()); return true; } },
          { key: 'Tab', run: (view) => acceptCompletion(view) || (text() ? startCompletion(view) : false) },
          { key: 'ArrowUp', run: arrow(-1) },
          { key: 'ArrowDown', run: arrow(1) },
          { key: 'Escape', run: (view) => { closeCompletion(view); view.contentDOM.blur(); return true; } },
        ])),
        history(),
        keymap.of([...historyKeymap, ...defaultKeymap]),
        autocompletion({ override: [complete], activateOnTyping: true, defaultKeymap: true, icons: false, interactionDelay: 0, aboveCursor: true }),
        placeholder('GRASP RIGHT-END-EFF MACS-NEW HANDLE-A'),
        EditorView.contentAttributes.of({ 'aria-label': 'sentence', spellcheck: 'false', autocapitalize: 'off' }),
        EditorView.updateListener.of((update) => {
          if (!update.docChanged) return;
          state.line = text();
          emit('line');
          later();
        }),
      ],
    }),
  });
  document.getElementById('do').addEventListener('click', () => submit(text()));
  document.getElementById('test').addEventListener('click', () => test(text()));
  window.addEventListener('keydown', (event) => {
    if (event.key === '/' && !event.target.closest?.('.cm-editor, input')) { event.preventDefault(); editor.focus(); }
  });
  on('prediction', showTested);
  on('rows', showRefusedTest);
  on('rows', giveBackRefused);
  on('rows', tellEnded);
  if (state.role === 'observer') {
    for (const name of ['do', 'test']) document.getElementById(name).disabled = true;
    say('this console has the role of an observer: it only looks', 'next');
  }
}

let timer = 0;

function later() {
  clearTimeout(timer);
  timer = setTimeout(check, 120);
}

// --- what a TEST has found ---

function showTested() {
  const found = state.prediction;
  tested.hidden = !found;
  if (!found) return;
  const { rehearsal } = found, sentence = found.text.replace(/^\s*(TEST|SIMULATE)\s+/i, '');
  const assumes = rehearsal.assumes ?? [];
  const all = tried.at(-1) === sentence ? tried : [sentence];
  tested.className = 'fine';
  tested.replaceChildren(
    element('span', { class: 'tag' }, 'tested'),
    element('code', { title: sentence }, all.join('; ')),
    element('span', { title: assumes.join('\n') },
      `about ${seconds(rehearsal.predicted_s ?? 0)}${assumes.length ? `, assumes ${assumes.length} thing${assumes.length > 1 ? 's' : ''}` : ''}`),
    ...(rehearsal.remark ? [element('span', {}, rehearsal.remark)] : []),
    element('button', { class: 'primary', title: 'refused if a fact that the test relies on has changed',
      onclick: () => doAll(all, { if_tested: rehearsal.digest }) }, 'Do as tested'),
    element('button', { class: 'quiet', 'aria-label': 'close', onclick: () => { tested.hidden = true; } }, '✕'),
  );
}

// --- advice: an alternative is tested on paper when it is pressed, and then done as tested ---

let tried = []; // sentences of the alternative whose last test is shown
let newest = ''; // command of this page; the advice of earlier ones would take the place of its test

function offerAdvice(command, { kind, refusal }) {
  if (command !== newest) return;
  const { text } = state.rows.get(command);
  const options = kind === 'succeeded' || TEST.test(text) ? [] : (refusal?.clears ?? []).filter((one) => !one.states);
  const buttons = options.map(({ sentences = [], words = '', again }) => [[...sentences, ...(again ? [text] : [])], words])
    .filter(([all]) => all.length).slice(0, 3)
    .map(([all, words]) => element('button', { title: words, onclick: () => tryOut(all) }, all.join('; ')));
  if (!buttons.length) return;
  tested.hidden = false;
  tested.className = 'advice';
  tested.replaceChildren(element('span', { class: 'tag' }, 'to clear it'), ...buttons,
    element('button', { class: 'quiet', 'aria-label': 'close', onclick: () => { tested.hidden = true; } }, '✕'));
}

// Each sentence is tested in the world after the one before.
export async function tryOut(sentences) {
  tried = sentences;
  let after = '';
  for (const sentence of sentences) {
    const outcome = await ended(await submit(testOf(sentence), { after_test: after }));
    if (outcome?.kind !== 'succeeded') return; // the strip says why
    after = outcome.rehearsal.digest;
  }
}

async function doAll(sentences, about) {
  for (const sentence of sentences) {
    if ((await ended(await submit(sentence, about)))?.kind !== 'succeeded') return;
  }
}

// The outcome of a command of this page; of one that was not accepted none.
function ended(command) {
  return new Promise((resolve) => {
    if (!command) { resolve(null); return; }
    waiting.set(command, resolve);
    tellEnded();
  });
}

const waiting = new Map(); // command -> who waits for its outcome

function tellEnded() {
  for (const [command, resolve] of waiting) {
    const outcome = state.rows.get(command)?.outcome;
    if (outcome && waiting.delete(command)) resolve(outcome);
  }
}

let shownTest = '';

// A TEST that is not feasible: the reason, and the sentences that were tested in its place.
function showRefusedTest() {
  const row = state.rows.get(state.chosen);
  const outcome = row?.outcome;
  if (!outcome || shownTest === row.command || !TEST.test(row.text) || outcome.kind === 'succeeded') return;
  shownTest = row.command;
  tested.hidden = false;
  tested.className = 'wrong';
  const repairs = outcome.rehearsal?.repairs ?? [];
  tested.replaceChildren(
    element('span', { class: 'tag' }, 'not feasible'),
    element('span', { class: 'reason', title: outcome.message }, outcome.refusal?.message ?? outcome.message ?? ''),
    ...repairs.slice(0, 2).map((repair) => element('button', { title: `${repair.changes}: ${repair.sentences.join('; ')}`,
      onclick: () => write(repair.sentences[0]) }, repair.sentences[0])),
    element('button', { class: 'quiet', 'aria-label': 'close', onclick: () => { tested.hidden = true; } }, '✕'),
  );
}
