// One track per arm and one for the cameras: commands as bars over time, their steps, trims and outcomes.
import { element, emit, nowS, on, state } from './store.js';

const WINDOW_S = 45, AHEAD_S = 8;
const SYMBOL = { succeeded: '✓', failed: '✕', refused: '⊘', halted: '■', halt_not_confirmed: '■', aborted: '■', lost_subsystem: '✕' };
const GOOD_ENDS = new Set(['goal', 'contact', 'found', 'operator_done', null]);
const holder = document.getElementById('tracks');
let lanes = [], bars = new Map();

export function openTracks() {
  const cameras = state.scene.cameras.length ? ['cameras'] : [];
  lanes = [...state.scene.arms.map((arm) => arm.name), ...cameras].map((name) => {
    const track = element('div', { class: 'track' });
    holder.append(element('div', { class: 'lane' }, element('div', { class: 'name' }, name), track));
    return { name, track };
  });
  const scale = element('div', { class: 'scale' });
  for (let back = 40; back >= 0; back -= 10) {
    const tick = element('span', {}, back ? `−${back} s` : 'now');
    tick.style.left = `${percent(-back)}%`;
    scale.append(tick);
  }
  holder.append(element('div', { class: 'lane scale-lane' }, element('div', { class: 'name' }), scale));
  for (const { track } of lanes) {
    const now = element('i', { class: 'now' });
    now.style.left = `${percent(0)}%`;
    track.append(now);
  }
  on('rows', update);
  setInterval(update, 200);
}

const percent = (fromNow) => (100 * (fromNow + WINDOW_S)) / (WINDOW_S + AHEAD_S);

function update() {
  const now = nowS();
  if (!Number.isFinite(now) || document.hidden) return;
  const seen = new Set();
  for (const row of state.rows.values()) {
    const end = row.ended_at_s ?? now;
    if (end < now - WINDOW_S) continue;
    for (const lane of lanes) {
      if (!belongs(row, lane.name)) continue;
      const key = `${row.command} ${lane.name}`;
      seen.add(key);
      drawBar(key, lane, row, now);
    }
  }
  for (const [key, bar] of bars) if (!seen.has(key)) { bar.remove(); bars.delete(key); }
}

function belongs(row, lane) {
  if (lane === 'cameras') return (row.spans ?? []).some(ofCamera);
  return (row.performers ?? []).includes(lane);
}

// A subsystem whose name is not that of one with arms: its steps have no motion.
const ofCamera = (span) => state.status.subsystems?.some((one) => one.name === span.node
  && one.performers.every((name) => state.scene.cameras.includes(name)));

// Whether a step ended otherwise than its script expects: a correction followed it, or it was the last of a command
// that did not succeed. Scripts expect other ends than the goal, too: a camera that finds nothing, no contact.
function isOff(row, span) {
  if (GOOD_ENDS.has(span.reason)) return false;
  const next = row.spans[row.spans.indexOf(span) + 1];
  if (!next) return row.outcome != null && row.outcome.kind !== 'succeeded';
  return row.marks.some((mark) => mark.kind === 'trim' && mark.at_s >= span.to_s && mark.at_s <= next.from_s);
}

function drawBar(key, lane, row, now) {
  let bar = bars.get(key);
  if (!bar) {
    bar = element('button', { class: 'bar', onclick: () => { state.chosen = row.command; emit('chosen', true); } });
    bars.set(key, bar);
    lane.track.append(bar);
  }
  const cameras = lane.name === 'cameras';
  const spans = (row.spans ?? []).filter((span) => ofCamera(span) === cameras || !cameras);
  const own = cameras ? spans.filter(ofCamera) : spans;
  const from = cameras && own.length ? own[0].from_s : row.accepted_at_s;
  const to = cameras && own.length ? own.at(-1).to_s ?? now : row.ended_at_s ?? now;
  const left = Math.max(0, percent(from - now)), right = Math.max(left, percent(to - now));
  bar.style.left = `${left}%`;
  bar.style.width = `max(6px, ${right - left}%)`;
  const stamp = `${row.last_seq} ${row.ended_at_s ?? ''} ${row.outcome?.kind} ${own.length}`;
  bar.title = `${row.command}  ${row.text}\n${row.step ?? ''}${row.outcome?.message ? `\n${row.outcome.message}` : ''}`;
  const paper = /^\s*(TEST|SIMULATE)\b/i.test(row.text) ? ' paper' : '';
  bar.className = `bar ${row.outcome?.kind ?? row.phase}${paper}`;
  bar.setAttribute('aria-label', bar.title);
  const begin = Math.max(from, now - WINDOW_S), wide = Math.max(1e-3, to - begin);
  const part = (at) => `${(100 * Math.max(0, at - begin)) / wide}%`;
  if (bar.stamp !== stamp || row.ended_at_s == null || from < now - WINDOW_S) {
    bar.stamp = stamp;
    const title = element('span', { class: 'title' }, element('b', {}, row.command), ` ${cameras ? '' : row.text}`);
    const strip = element('span', { class: 'strip' });
    for (const span of own) {
      const end = span.to_s ?? now;
      if (end < begin) continue;
      const step = element('i', {
        class: `step ${span.to_s == null ? 'running' : isOff(row, span) ? 'off' : ''} ${!cameras && ofCamera(span) ? 'seen' : ''}`,
        title: [span.step, span.reason, span.message].filter(Boolean).join(': ') });
      step.style.left = part(span.from_s);
      step.style.width = `${(100 * (end - Math.max(begin, span.from_s))) / wide}%`;
      strip.append(step);
    }
    for (const mark of cameras ? [] : row.marks ?? []) {
      if (mark.at_s < begin) continue;
      const sign = element('i', { class: `mark ${mark.kind}`, title: mark.words });
      sign.style.left = part(mark.at_s);
      strip.append(sign);
    }
    bar.replaceChildren(title, strip, element('span', { class: 'end' }, cameras ? '' : SYMBOL[row.outcome?.kind] ?? ''));
  }
}
