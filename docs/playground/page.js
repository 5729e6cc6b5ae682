/* Controls, time and what is shown. */
"use strict";

const SHOWN = 8; // seconds in the panels
const MEAN = 2; // seconds over which the error is averaged
const element = (id) => document.getElementById(id);

/** A slider with its name and value; `change` gets the value in the unit of the program. */
function slider(parent, { name, unit, low, high, value, logarithmic, digits, scale = 1 }, change) {
  const label = document.createElement("label");
  label.innerHTML = '<span class="name"><span></span><output></output></span><input type="range">';
  const [words, output, input] = [label.querySelector("span span"), label.querySelector("output"), label.querySelector("input")];
  const [inwards, outwards] = logarithmic ? [Math.log10, (at) => 10 ** at] : [(at) => at, (at) => at];
  words.textContent = name;
  Object.assign(input, { min: inwards(low), max: inwards(high), step: "any" });
  const show = () => {
    const shown = outwards(Number(input.value));
    const fitting = digits === undefined ? Math.min(Math.max(2 - Math.floor(Math.log10(Math.abs(shown) + 1e-9)), 0), 4) : digits;
    output.textContent = `${number(shown, fitting)} ${unit}`;
    change(shown * scale);
  };
  const set = (to) => {
    input.value = inwards(to / scale);
    show();
  };
  input.addEventListener("input", show);
  parent.append(label);
  set(value * scale);
  return { set, label };
}

function readTheme() {
  const style = getComputedStyle(document.documentElement);
  const of = (name) => style.getPropertyValue(`--${name}`).trim();
  const dark = matchMedia("(prefers-color-scheme: dark)").matches;
  const names = ["ink", "soft", "grid", "edge", "steel", "rod", "piston", "load", "reference"];
  const colours = FACTS.leakColours.map(([red, green, blue]) => (dark ? [red, green, blue].map((one) => Math.round(one + 0.35 * (255 - one))) : [red, green, blue]));
  return {
    ...Object.fromEntries(names.map((name) => [name, of(name)])),
    onOil: of("on-oil"),
    axis: FACTS.axes.map((_, place) => of(`axis-${place}`)),
    oil: FACTS.oil,
    leak: (flow) => between(colours, (Math.log10(Math.max(flow, 0.01)) + 2) / (Math.log10(4) + 2)),
  };
}

function makeCard(axis, place) {
  const card = document.createElement("article");
  card.className = "axis";
  card.style.setProperty("--mine", `var(--axis-${place})`);
  card.innerHTML = `<h2></h2><canvas role="img" aria-label="Cylinder, load and valve of this axis"></canvas>
    <dl class="figures"><dt>mean error, last ${MEAN} s</dt><dd></dd><dt>valve travel, full strokes per second</dt><dd></dd></dl>
    <div class="meter" role="img" aria-label="Probability of a leak"><i></i><b></b></div><p class="verdict"></p>`;
  const title = card.querySelector("h2");
  title.append(axis.name);
  card.querySelector(".meter b").style.left = `${100 * FACTS.threshold}%`;
  element("axes").append(card);
  const [error, travel] = card.querySelectorAll("dd");
  return { title, canvas: card.querySelector("canvas"), error, travel, bar: card.querySelector("i"), verdict: card.querySelector(".verdict") };
}

function verdictOf(read, time) {
  const probability = read("probability");
  if (Number.isNaN(probability)) return [`detector: listening, ${number(Math.max(FACTS.window - time, 0), 1)} s more`, false];
  if (read("outside") === 2) return ["detector: an axis at rest does not tell a leak from a shifted valve; no answer", false];
  if (read("outside") > 0) return ["detector: unlike all it was trained on; no answer", false];
  const percent = `${number(100 * probability, 0)} %`;
  if (probability < FACTS.threshold) return [`detector: leak with ${percent}; not flagged`, false];
  const [flow, low, high] = ["flow_lpm", "low_lpm", "high_lpm"].map((name) => number(read(name), 2));
  return [`leak (${percent}): ${flow} l/min (90 %: ${low} to ${high})`, true];
}

async function main() {
  const machine = await startMachine(FACTS, WASM);
  const period = FACTS.period;
  const settings = { leak: 0.01, where: "all", rig: {}, motion: { kind: "smooth moves", size: 0.04, period: 3 }, speed: 1, running: true };
  const pace = FACTS.axes.map(() => 0);
  const names = FACTS.axes.flatMap((_, axis) => ["position", "error", "a", "b", "probability", "travel"].map((name) => `${name}${axis}`));
  let theme = readTheme();
  let reference, history, time, changes, pressuresOf = 1;
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => (theme = readTheme()));
  const cards = FACTS.axes.map(makeCard);
  const wide = matchMedia("(min-width: 1150px)").matches; // where the settings stand beside the axes
  document.querySelectorAll("details").forEach((part) => (part.open = wide));

  const throttle = (leak) => FACTS.testPressure / (leak * FACTS.litrePerMinute);
  const applyRig = () => {
    FACTS.axes.forEach((_, axis) => {
      const changed = settings.where === "all" || axis === FACTS.axes.length - 1;
      const values = changed ? { ...settings.rig, "leakage.internal_resistance": throttle(settings.leak) } : FACTS.own;
      machine.change(axis, { ...FACTS.own, ...values });
    });
    if (changes && (time - changes[changes.length - 1] > 0.5 || !changes.length)) changes.push(time);
  };
  const restart = () => {
    reference = new Reference(FACTS.centre, { ...settings.motion });
    history = new History(["reference", ...names], Math.round(SHOWN / period));
    [time, changes] = [0, []];
    machine.change(0, FACTS.own);
    machine.begin(reference.at(0), FACTS.seed, FACTS.seed);
    applyRig();
    changes = [];
  };

  // Controls.
  const leakSlider = element("leak");
  const setLeak = () => {
    settings.leak = 10 ** Number(leakSlider.value);
    element("leak-value").textContent = `${number(settings.leak, 2)} l/min`;
    leakSlider.style.setProperty("--leak", theme.leak(settings.leak));
    applyRig();
  };
  leakSlider.addEventListener("input", setLeak);
  for (const one of FACTS.rigSliders)
    slider(element("rig"), one, (value) => {
      settings.rig[one.parameter] = value;
      applyRig();
    });
  element("where").addEventListener("change", (event) => {
    settings.where = event.target.value;
    applyRig();
  });
  for (const kind of Object.keys(SHAPES)) element("kind").add(new Option(kind, kind));
  const move = (values) => {
    Object.assign(settings.motion, values);
    if (reference) reference.change({ ...settings.motion }, time);
    const { kind, size, period: turn } = settings.motion;
    const needed = (STEEPNESS[kind] * size) / turn;
    const hint = element("speed-hint");
    hint.hidden = !(needed > FACTS.largestSpeed) || needed === Infinity;
    hint.textContent = `It needs ${number(needed, 2)} m/s; the fully open valve gives ${number(FACTS.largestSpeed, 2)} m/s.`;
  };
  element("kind").addEventListener("change", (event) => move({ kind: event.target.value }));
  slider(element("motion"), { name: "Size", unit: "mm", digits: 0, low: 1, high: 80, value: 40, scale: 1e-3 }, (size) => move({ size }));
  slider(element("motion"), { name: "Period", unit: "s", low: 0.3, high: 8, value: 3, logarithmic: true, digits: 1 }, (turn) => move({ period: turn }));
  const kinds = element("controller");
  FACTS.controllers.forEach(({ name }, place) => kinds.add(new Option(name, place)));
  const gains = FACTS.gainSliders.map((one) => ({ one, ...slider(element("gains"), one, (value) => machine.tune({ [one.gain]: value })) }));
  const choose = () => {
    const { kind, name } = FACTS.controllers[Number(kinds.value)];
    cards[cards.length - 1].title.textContent = `Mine: ${name}`;
    machine.choose(FACTS.axes.length - 1, Number(kinds.value));
    for (const { one, label } of gains) label.hidden = one.controller !== kind;
    element("tuned").hidden = !gains.some(({ label }) => !label.hidden);
  };
  kinds.addEventListener("change", choose);
  element("tuned").addEventListener("click", () => gains.forEach(({ one, set }) => set(one.value * (one.scale || 1))));
  FACTS.axes.forEach((axis, place) => machine.choose(place, axis.controller));
  kinds.value = FACTS.axes[FACTS.axes.length - 1].controller;
  choose();
  element("pause").addEventListener("click", (event) => {
    settings.running = !settings.running;
    event.target.textContent = settings.running ? "Pause" : "Go on";
  });
  element("restart").addEventListener("click", restart);
  element("speed").addEventListener("change", (event) => (settings.speed = Number(event.target.value)));

  // Panels.
  const lines = (name) => FACTS.axes.map((_, axis) => ({ name: `${name}${axis}`, colour: theme.axis[axis] }));
  const panels = [
    () => ({ title: "Position, mm (dashed: reference)", least: 2, lines: [...lines("position"), { name: "reference", colour: theme.reference, dash: [5, 4], width: 1.2 }] }),
    () => ({ title: "Position error, mm", least: 0.2, lines: lines("error"), marks: [0] }),
    () => ({
      title: `Pressures, bar: ${FACTS.axes[pressuresOf].name} (dashed: b)`,
      least: 10,
      lines: [{ name: `a${pressuresOf}`, colour: theme.axis[pressuresOf] }, { name: `b${pressuresOf}`, colour: theme.axis[pressuresOf], dash: [5, 4] }],
    }),
    () => ({ title: "Probability of a leak (dotted: flagged from here)", low: 0, high: 1, lines: lines("probability"), marks: [FACTS.threshold] }),
  ];
  const canvases = panels.map((panel) => {
    const canvas = document.createElement("canvas");
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", panel().title);
    element("plots").append(canvas);
    return canvas;
  });
  cards.forEach(({ canvas }, axis) => canvas.addEventListener("click", () => (pressuresOf = axis)));

  const step = () => {
    machine.step((ahead) => reference.at(time + ahead));
    time += period;
    const now = reference.at(time);
    const row = { reference: 1e3 * now };
    FACTS.axes.forEach((_, axis) => {
      const read = (name) => machine.read(axis, name);
      pace[axis] = 0.5 * Math.abs(read("spool_velocity"));
      Object.assign(row, {
        [`position${axis}`]: 1e3 * read("position"),
        [`error${axis}`]: 1e3 * (now - read("position") - read("position_bias")),
        [`a${axis}`]: bar(read("measured_pressure_a")),
        [`b${axis}`]: bar(read("measured_pressure_b")),
        [`probability${axis}`]: read("outside") > 0 ? NaN : read("probability"),
        [`travel${axis}`]: pace[axis],
      });
    });
    history.add(row);
  };
  const mean = (name, of) => {
    const count = Math.min(history.count, Math.round(MEAN / period));
    let total = 0;
    for (let back = 0; back < count; back++) total += of(history.back(name, back));
    return total / Math.max(count, 1);
  };
  const draw = () => {
    FACTS.axes.forEach((_, axis) => {
      const read = (name) => machine.read(axis, name);
      const card = cards[axis], changed = settings.where === "all" || axis === FACTS.axes.length - 1;
      drawAxis(card.canvas, {
        position: read("position"), bias: read("position_bias"), reference: reference.at(time), stroke: FACTS.stroke, spool: read("spool_position"),
        pressureA: read("pressure_a"), pressureB: read("pressure_b"), supply: read("supply_pressure"),
        leak: changed ? settings.leak : 0.01, leakFlow: read("leakage_flow") / FACTS.litrePerMinute,
        mass: changed ? settings.rig["load.mass"] : FACTS.own["load.mass"],
      }, { ...theme, accent: theme.axis[axis] });
      card.error.textContent = `${number(mean(`error${axis}`, Math.abs), 3)} mm`;
      card.travel.textContent = `${number(mean(`travel${axis}`, (one) => one), 2)}`;
      const [words, flagged] = verdictOf(read, time);
      card.bar.style.width = `${100 * (read("probability") || 0)}%`;
      card.verdict.textContent = words;
      card.verdict.classList.toggle("leak", flagged);
    });
    panels.forEach((panel, place) => drawPanel(canvases[place], panel(), history, time, period, theme, changes));
  };
  let last, owed = 0;
  const frame = (now) => {
    if (settings.running && last !== undefined) {
      owed += settings.speed * Math.min((now - last) / 1e3, 0.1);
      for (; owed >= period; owed -= period) step();
    }
    last = now;
    draw();
    requestAnimationFrame(frame);
  };
  restart();
  setLeak();
  changes = [];
  window.playground = { machine, settings, step, draw, restart, time: () => time };
  requestAnimationFrame(frame);
}

main();
