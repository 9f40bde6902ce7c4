// The scene: bodies made once from the gateway's description, then moved by frames of poses. It knows no robot.
import {
  BoxGeometry, BufferAttribute, BufferGeometry, CapsuleGeometry, Color, CylinderGeometry, DirectionalLight, GridHelper,
  Group, HemisphereLight, Mesh, MeshLambertMaterial, OrbitControls, PerspectiveCamera, Quaternion, Scene, SphereGeometry,
  TransformControls, Vector3, WebGLRenderer,
} from './vendor.js';
import { links } from './links.js';
import { element, emit, measuredAge, on, seconds, state } from './store.js';

const HEADER = 24;
const OFF_M = 0.002, OFF_RAD = 0.02; // a ghost is shown where it differs by more
const GHOSTS = { belief: 0x2f81f7, prediction: 0xe08a00 };
const SLOW_MS = 60; // from frame to frame: above it fewer pixels are drawn
const REST_MS = 120; // without a graphics processor: the keys and the operator's stream come first
export const view = { frames: 0, drawn: 0, latencies: [], sets: {}, shown: { belief: true, prediction: true, labels: true } };

let renderer, camera, controls, scene, wanted = true, bodies = [], costMs = 0, share = 1, lastMs = 0, drawnMs = 0, drewLast = false;
const canvas = document.getElementById('canvas');
const box = document.getElementById('view');

function geometryOf(shape) {
  const [a, b, c] = shape.size ?? [];
  switch (shape.type) {
    case 'box': return new BoxGeometry(a, b, c);
    case 'sphere': return new SphereGeometry(a, 20, 14);
    case 'cylinder': return new CylinderGeometry(a, a, b, 28).rotateX(Math.PI / 2); // along z, as in the cell
    case 'capsule': return new CapsuleGeometry(a, b, 6, 20).rotateX(Math.PI / 2);
    default: {
      const made = new BufferGeometry();
      made.setAttribute('position', new BufferAttribute(new Float32Array(shape.vertices), 3));
      made.setIndex(shape.faces);
      const flat = made.toNonIndexed();
      flat.computeVertexNormals();
      return flat;
    }
  }
}

function place(object, pose, at = 0) {
  object.position.set(pose[at], pose[at + 1], pose[at + 2]);
  object.quaternion.set(pose[at + 3], pose[at + 4], pose[at + 5], pose[at + 6]);
}

function build(body, ghost) {
  const group = new Group();
  group.name = body.name;
  for (const shape of body.shapes) {
    const [r, g, b, a] = shape.colour;
    const material = ghost
      ? new MeshLambertMaterial({ color: GHOSTS[ghost], transparent: true, opacity: 0.32, depthWrite: false })
      : new MeshLambertMaterial({ color: new Color().setRGB(r, g, b, 'srgb'), transparent: a < 1, opacity: a });
    const mesh = new Mesh(geometryOf(shape), material);
    place(mesh, shape.pose);
    group.add(mesh);
  }
  group.visible = !ghost;
  scene.add(group);
  return group;
}

export function openScene(description) {
  renderer = new WebGLRenderer({ canvas, antialias: true, preserveDrawingBuffer: Boolean(navigator.webdriver) });
  scene = new Scene();
  camera = new PerspectiveCamera(38, 1, 0.05, 60);
  camera.up.set(0, 0, 1);
  controls = new OrbitControls(camera, canvas);
  controls.enableDamping = false;
  controls.addEventListener('change', () => { wanted = true; });
  scene.add(new HemisphereLight(0xffffff, 0x667080, 2.1));
  const sun = new DirectionalLight(0xffffff, 1.7);
  sun.position.set(-2, -3, 5);
  scene.add(sun);
  bodies = description.bodies.map((body) => ({
    ...body, shownAs: build(body), belief: build(body, 'belief'), prediction: build(body, 'prediction'),
  }));
  dress();
  look('overview');
  new ResizeObserver(resize).observe(box);
  resize();
  legend();
  labels();
  on('frame', take);
  document.addEventListener('visibilitychange', () => links.poses?.acknowledge());
  requestAnimationFrame(draw);
}

// Colours of the style sheet, also after a change between light and dark.
export function dress() {
  if (!scene) return;
  const style = getComputedStyle(document.documentElement);
  const colour = (name) => new Color(style.getPropertyValue(name).trim());
  scene.background = colour('--scene');
  const old = scene.getObjectByName('grid');
  if (old) scene.remove(old);
  const grid = new GridHelper(6, 24, colour('--grid-strong'), colour('--grid'));
  grid.rotateX(Math.PI / 2);
  grid.name = 'grid';
  scene.add(grid);
  wanted = true;
}

const VIEWS = { overview: [-1.0, -0.75, 0.62], front: [-1, 0, 0.25], left: [0, 1, 0.3], right: [0, -1, 0.3], top: [-0.01, 0, 1] };

export function look(name) {
  const middle = new Vector3(), low = new Vector3(1e9, 1e9, 1e9), high = new Vector3(-1e9, -1e9, -1e9);
  for (const body of bodies) {
    if (!body.shapes.length) continue;
    low.min(body.shownAs.position); high.max(body.shownAs.position);
  }
  middle.addVectors(low, high).multiplyScalar(0.5);
  if (!Number.isFinite(middle.x) || bodies.length === 0) middle.set(0, 0, 0.5);
  const radius = Math.max(0.6, low.distanceTo(high) / 2);
  middle.z += 0.1 * radius; // arms reach up
  controls.target.copy(middle);
  camera.position.copy(new Vector3(...VIEWS[name]).normalize().multiplyScalar(radius * 2.7).add(middle));
  controls.update();
  wanted = true;
}

function resize() {
  const { clientWidth, clientHeight } = box;
  if (!clientWidth || !clientHeight) return;
  renderer.setPixelRatio(share * Math.min(window.devicePixelRatio, 2));
  renderer.setSize(clientWidth, clientHeight, false);
  camera.aspect = clientWidth / clientHeight;
  camera.updateProjectionMatrix();
  wanted = true;
}

let pending = null, fitted = false;

function take(data) {
  pending = data;
  view.frames += 1;
}

// Put the latest frame into the scene. Returns whether a body has moved.
function apply(data) {
  const header = new DataView(data, 0, HEADER);
  const flags = header.getUint32(4, true);
  const measuredAt = header.getFloat64(8, true);
  const values = new Float32Array(data, HEADER), size = 7 * bodies.length;
  state.measuredAt = measuredAt;
  state.truthKnown = (flags & 1) !== 0;
  const shown = values.subarray(0, size), belief = values.subarray(size, 2 * size);
  const prediction = state.prediction?.poses ?? null;
  const before = view.sets;
  const changed = !before.shown || differs(before.shown, shown) || differs(before.belief, belief)
    || prediction !== before.prediction;
  view.sets = { shown: shown.slice(), belief: belief.slice(), prediction };
  if (!changed) return false;
  bodies.forEach((body, n) => {
    const at = 7 * n;
    place(body.shownAs, shown, at);
    ghost(body.belief, belief, shown, at, view.shown.belief);
    ghost(body.prediction, prediction, shown, at, view.shown.prediction);
  });
  settle();
  if (!fitted) { fitted = true; look('overview'); }
  return true;
}

function ghost(object, poses, shown, at, on) {
  object.visible = Boolean(on && poses && isOff(poses, shown, at));
  if (object.visible) place(object, poses, at);
}

function isOff(a, b, at) {
  const far = Math.hypot(a[at] - b[at], a[at + 1] - b[at + 1], a[at + 2] - b[at + 2]);
  const dot = Math.abs(a[at + 3] * b[at + 3] + a[at + 4] * b[at + 4] + a[at + 5] * b[at + 5] + a[at + 6] * b[at + 6]);
  return far > OFF_M || 2 * Math.acos(Math.min(1, dot)) > OFF_RAD;
}

function differs(a, b) {
  if (a.length !== b.length) return true;
  for (let n = 0; n < a.length; n += 1) if (Math.abs(a[n] - b[n]) > 2e-5) return true;
  return false;
}

// The time from one drawn frame to the next, also what the graphics processor took: a slow one draws fewer pixels.
function watchCost(nowMs) {
  const took = nowMs - lastMs, drawn = drewLast;
  lastMs = nowMs;
  drewLast = false;
  if (!drawn || took > 1000) return;
  costMs += 0.15 * (took - costMs);
  const wish = costMs > SLOW_MS ? Math.max(0.5, share * 0.8) : share;
  if (wish !== share) { share = wish; costMs = 0; resize(); }
}

function draw(nowMs) {
  requestAnimationFrame(draw);
  watchCost(nowMs);
  const data = pending;
  pending = null;
  if (data && apply(data)) wanted = true;
  const rests = share < 0.7 && nowMs < drawnMs + REST_MS;
  if (wanted && !state.lost && !rests) {
    drawnMs = nowMs;
    wanted = false;
    renderer.render(scene, camera);
    drewLast = true;
    view.drawn += 1;
    moveLabels();
    emit('drawn');
  }
  if (data) {
    const latency = measuredAge();
    if (state.moving.length && Number.isFinite(latency)) {
      view.latencies.push(latency);
      if (view.latencies.length > 5000) view.latencies.shift();
    }
    links.poses.acknowledge();
  }
}

// --- beside the picture ---

function legend() {
  const holder = document.getElementById('legend');
  const toggle = (key, text, colour) => {
    const input = element('input', { type: 'checkbox', checked: view.shown[key] });
    input.addEventListener('change', () => { view.shown[key] = input.checked; view.sets = {}; wanted = true; labelsShown(); });
    return element('label', { class: colour }, input, text);
  };
  const first = element('span', { class: 'solid' }, 'measured');
  on('frame', () => { first.textContent = state.truthKnown ? 'true' : 'measured'; });
  holder.replaceChildren(first, toggle('belief', 'believed', 'belief'), toggle('prediction', 'tested', 'prediction'),
    toggle('labels', 'names', 'plain'));
  document.getElementById('views').replaceChildren(...Object.keys(VIEWS).map((name) =>
    element('button', { class: 'quiet', onclick: () => look(name) }, name)));
  setInterval(age, 200);
}

function age() {
  const old = measuredAge();
  const shown = document.getElementById('age');
  shown.textContent = Number.isFinite(old) ? `${seconds(Math.max(0, old))} old` : '';
  shown.classList.toggle('old', old > 1.5 + state.delayS);
}

let named = [];

function labels() {
  const holder = document.getElementById('labels');
  const arms = state.scene.arms.map((arm) => [arm.name, bodies.findLast((body) => body.owner === arm.name && body.shapes.length)]);
  const things = bodies.filter((body) => body.group === 'object').map((body) => [body.name, body]);
  named = [...arms, ...things].filter(([, body]) => body).map(([name, body]) => {
    const label = element('div', { class: `label ${body.group}` }, name);
    holder.append(label);
    return { label, body };
  });
  labelsShown();
  on('facts', wordLabels);
}

function labelsShown() { document.getElementById('labels').hidden = !view.shown.labels; }

function wordLabels() {
  for (const { label, body } of named) {
    const held = body.group === 'arm' ? state.facts.get(`${body.owner}.holding`)?.value : '';
    const doubt = body.group === 'object' ? state.facts.get(`${body.name}.frame`)?.validity : '';
    label.textContent = (body.group === 'arm' ? body.owner : body.name) + (held ? ` holds ${held}` : '')
      + (doubt && doubt !== 'valid' && doubt !== 'changing' ? ` (${doubt})` : '');
  }
}

const spot = new Vector3();

function moveLabels() {
  if (!view.shown.labels) return;
  const { clientWidth, clientHeight } = box;
  for (const { label, body } of named) {
    spot.copy(body.shownAs.position).project(camera);
    const x = (spot.x + 1) / 2 * clientWidth, y = (1 - spot.y) / 2 * clientHeight;
    const inside = (value, low, high) => Math.max(low, Math.min(high, value));
    label.style.transform = `translate(${inside(x, 0, clientWidth - 90).toFixed(0)}px, ${inside(y, 62, clientHeight).toFixed(0)}px)`;
    label.hidden = spot.z > 1;
  }
}

// --- the gizmo: an arm that the operator moves follows it while it is dragged ---

let held = null;

// `by`: {hold(want), release(), speed()}. Null as arm removes it.
export function gizmo(arm, by) {
  if (held) {
    held.controls.detach();
    scene.remove(held.controls.getHelper(), held.proxy);
    held.controls.dispose();
    held = null;
    wanted = true;
  }
  if (!arm || !scene) return;
  const body = bodyAt(state.scene.arms.find((one) => one.name === arm).tcp);
  const proxy = new Group(), handles = new TransformControls(camera, canvas);
  handles.setSize(0.75);
  handles.attach(proxy);
  scene.add(proxy, handles.getHelper());
  held = { arm, body, proxy, controls: handles };
  handles.addEventListener('change', () => { wanted = true; });
  handles.addEventListener('dragging-changed', ({ value }) => {
    controls.enabled = !value;
    if (value) by.hold(() => ({ twist: towards(proxy, body.shownAs, by.speed()), frame: 'world' }));
    else by.release();
  });
  settle();
  scene.updateMatrixWorld(); // it can be picked before it is drawn
  wanted = true;
}

// For tests and the keys of the gizmo; null without one.
export const grip = () => held && { arm: held.arm, mode: (mode) => held.controls.setMode(mode), at: () => onCanvas(held.proxy),
  picked: () => held.controls.axis };

function onCanvas(object) {
  const box = canvas.getBoundingClientRect(), spot = object.position.clone().project(camera);
  return [box.left + (spot.x + 1) / 2 * box.width, box.top + (1 - spot.y) / 2 * box.height];
}

function settle() {
  if (!held || held.controls.dragging) return;
  held.proxy.position.copy(held.body.shownAs.position);
  held.proxy.quaternion.copy(held.body.shownAs.quaternion);
}

// The velocity that leads from where the hand is to where the gizmo is, within the speeds.
function towards(goal, hand, [linear, turn]) {
  const way = goal.position.clone().sub(hand.position).multiplyScalar(2.5).clampLength(0, linear);
  const rest = goal.quaternion.clone().multiply(new Quaternion().copy(hand.quaternion).invert());
  if (rest.w < 0) rest.set(-rest.x, -rest.y, -rest.z, -rest.w);
  const spin = new Vector3(rest.x, rest.y, rest.z).multiplyScalar(5).clampLength(0, turn);
  return [way.x, way.y, way.z, spin.x, spin.y, spin.z];
}

export function bodyAt(name) {
  return bodies.find((body) => body.name === name);
}

export function redraw() { wanted = true; }
