/* The axes in WebAssembly: plant, sensors, controllers and detector in the C that hydro_env generates. */
"use strict";

async function startMachine(facts, base64) {
  const packed = Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  const { instance } = await WebAssembly.instantiate(await new Response(stream).arrayBuffer());
  const wasm = instance.exports;
  wasm._initialize();
  const array = (address, count) => new Float64Array(wasm.memory.buffer, address, count);
  const rig = array(wasm.rig(), facts.parameters.length);
  const reference = array(wasm.reference(), 1 + facts.previewTimes.length);
  const gains = array(wasm.gains(), facts.gains.length);
  const views = facts.axes.map((_, number) => array(wasm.view(number), facts.view.length));
  const places = Object.fromEntries(facts.view.map((name, place) => [name, place]));
  const parameter = Object.fromEntries(facts.parameters.map((name, place) => [name, place]));
  wasm.default_rig();

  return {
    /** Number of a signal in `read`, by its name. */
    places,
    /** Value of a signal of an axis after the last control period, in SI units. */
    read: (axis, name) => views[axis][places[name]],
    /** Change numbers of the rig, `{"supply.pressure": 7e6}`; the motion of the axes goes on. */
    change(axis, values) {
      for (const [name, value] of Object.entries(values)) rig[parameter[name]] = value;
      wasm.change_rig(axis);
    },
    /** Let all axes begin at rest at a position (m); all have the same noise. */
    begin(position, keyHigh, keyLow) {
      facts.axes.forEach((_, axis) => wasm.begin(axis, position, keyHigh, keyLow));
    },
    /** Set gains of the user's controller, `{"pid.proportional": 100}`. */
    tune(values) {
      for (const [name, value] of Object.entries(values)) gains[facts.gains.indexOf(name)] = value;
    },
    /** Choose the controller of an axis by its number in `facts.controllers`. */
    choose: (axis, controller) => wasm.choose(axis, controller),
    /** Advance all axes by a control period; `ahead(seconds)` is the reference (m) in so many seconds. */
    step(ahead) {
      [0, ...facts.previewTimes].forEach((time, place) => (reference[place] = ahead(time)));
      facts.axes.forEach((_, axis) => wasm.control(axis));
    },
    /** Advance one axis by a control period with a command of -1 to 1, without controller. */
    advance: (axis, command) => wasm.advance(axis, command),
  };
}

/** Reference shapes over a period: from -0.5 to 0.5, by the share of the period that has passed. */
const SHAPES = {
  "smooth moves": (share) => moves(share, 0.5, (part) => part ** 3 * (10 + part * (6 * part - 15))),
  "constant speed": (share) => moves(share, 0.6, (part) => part),
  steps: (share) => (share < 0.5 ? 0.5 : -0.5),
  sine: (share) => 0.5 * Math.sin(2 * Math.PI * share),
  "hold still": () => 0,
};

/** Out and back: each way takes a part of half a period, then the axis rests. */
function moves(share, busy, way) {
  const half = share < 0.5 ? share : share - 0.5;
  const done = way(Math.min(half / (0.5 * busy), 1));
  return share < 0.5 ? done - 0.5 : 0.5 - done;
}

/** Largest speed of a shape, per size and 1/period. */
const STEEPNESS = { "smooth moves": 7.5, "constant speed": 10 / 3, steps: Infinity, sine: Math.PI, "hold still": 0 };

/** The reference over time (s, m); a change fades in over half a second. */
class Reference {
  constructor(centre, settings) {
    this.centre = centre;
    this.before = this.now = settings;
    this.since = -1;
  }

  change(settings, time) {
    this.before = this.now;
    this.now = settings;
    this.since = time;
  }

  at(time) {
    const part = Math.min(Math.max((time - this.since) / 0.5, 0), 1);
    const value = ({ kind, size, period }) => size * SHAPES[kind]((time / period) % 1);
    const blend = part * part * (3 - 2 * part);
    return this.centre + (1 - blend) * value(this.before) + blend * value(this.now);
  }
}
