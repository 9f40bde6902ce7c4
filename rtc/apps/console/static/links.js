// The three sockets of the page: poses, story, halt. Each connects again by itself, and says at once that it is lost.
import { emit, state, takeClock, takePredictions } from './store.js';

const AGAIN_MS = 400;
const SILENT_MS = 1500; // the gateway sends poses every 500 ms at least, and answers pings every second

function url(path) {
  return `${location.protocol === 'https:' ? 'wss' : 'ws'}://${location.host}${path}`;
}

class Link {
  constructor(name, binary = false) {
    this.name = name;
    this.binary = binary;
    this.heardAt = -Infinity;
    this.connect();
  }

  connect() {
    const socket = new WebSocket(url(`/${this.name}`));
    if (this.binary) socket.binaryType = 'arraybuffer';
    this.socket = socket;
    socket.onopen = () => { this.heardAt = performance.now(); this.opened(); this.set(true); };
    socket.onmessage = (event) => { this.heardAt = performance.now(); this.set(true); this.take(event.data); };
    socket.onclose = () => {
      if (this.socket !== socket) return;
      this.set(false);
      setTimeout(() => this.connect(), AGAIN_MS);
    };
  }

  set(up) {
    if (state.links[this.name] === up) return;
    state.links[this.name] = up;
    emit('links');
  }

  // A connection without a sign of life is lost, although the browser has not noticed it yet.
  watch() {
    if (this.socket.readyState === WebSocket.OPEN && performance.now() - this.heardAt > SILENT_MS) {
      this.set(false);
      this.socket.close();
      const dead = this.socket;
      dead.onclose = null;
      this.connect();
    }
  }

  send(text) {
    if (this.socket.readyState !== WebSocket.OPEN) return false;
    this.socket.send(text);
    return true;
  }

  opened() {}
}

class Poses extends Link {
  constructor() { super('poses', true); this.waiting = 0; }

  opened() { this.waiting = 0; this.askClock(); }

  askClock() { this.send(`clock ${performance.now()}`); }

  take(data) {
    if (typeof data === 'string') {
      const [, sent, now] = data.split(' ');
      takeClock(Number(sent), Number(now));
      return;
    }
    this.waiting += 1;
    state.frameAt = performance.now();
    emit('frame', data);
  }

  // The scene calls it once it has drawn: the gateway then sends the latest frame, and none that is late.
  acknowledge() {
    while (this.waiting > 0) { this.waiting -= 1; this.send('ack'); }
  }
}

class Story extends Link {
  constructor() { super('story'); }

  take(data) {
    const message = JSON.parse(data);
    if (message.hello) {
      if (state.life && state.life !== message.hello.life) { state.rows.clear(); state.n = 0; }
      state.life = message.hello.life;
      state.where = message.hello.where;
      state.delayS = message.hello.delay_s ?? 0;
    }
    if (message.snapshot) {
      state.rows.clear();
      for (const row of message.snapshot.rows) state.rows.set(row.command, row);
      state.lines = message.snapshot.lines;
      state.n = message.snapshot.n;
      emit('rows');
    }
    if (message.change) this.change(message.change);
    if (message.facts) {
      if (message.anew) state.facts.clear();
      for (const fact of message.facts) state.facts.set(fact.key, fact);
      emit('facts');
    }
    if ('clock_s' in message) state.clockS = message.clock_s;
    if (message.status) { state.status = message.status; state.statusAt = message.at_s; emit('status'); }
    if (message.moving) { state.moving = message.moving; emit('moving'); }
    if (message.arms) { state.arms = message.arms; emit('arms'); }
    if (message.predictions) takePredictions(message.predictions);
  }

  change(change) {
    if (change.n <= state.n) return;
    if (change.n !== state.n + 1) { this.send(JSON.stringify({ since: state.n })); return; } // a gap
    state.n = change.n;
    for (const row of change.rows) state.rows.set(row.command, row);
    state.lines = [...state.lines, ...change.lines].slice(-200);
    emit('rows', change);
  }
}

class Halt extends Link {
  constructor() { super('halt'); this.open = new Map(); this.number = 0; this.wayMs = NaN; }

  ping() { this.send(JSON.stringify({ ping: performance.now() })); }

  take(data) {
    const message = JSON.parse(data);
    if ('pong' in message) { this.wayMs = performance.now() - message.pong; return; }
    if (message.rests) { if (this.open.has(message.id)) emit('rests', message.rests); return; }
    const done = this.open.get(message.id);
    this.open.delete(message.id);
    if (done) done(message.result);
  }

  // The result of a halt; undefined if this socket cannot send it.
  order(scope) {
    this.number += 1;
    const id = this.number;
    if (!this.send(JSON.stringify({ id, scope }))) return undefined;
    return new Promise((done) => this.open.set(id, done));
  }
}

class Operate extends Link {
  constructor() { super('operate'); }

  take(data) { emit('operated', JSON.parse(data)); }
}

export const links = {};

export function openLinks() {
  links.halt = new Halt();
  links.poses = new Poses();
  links.story = new Story();
  if (state.role === 'operator') links.operate = new Operate();
  setInterval(() => links.halt.ping(), 500);
  setInterval(() => links.poses.askClock(), 2000);
  setInterval(() => { links.halt.watch(); if (!document.hidden) links.poses.watch(); }, 250);
}
