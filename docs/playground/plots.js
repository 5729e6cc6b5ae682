/* Lines over the last seconds, one panel each. */
"use strict";

/** Samples of the last seconds, newest last. */
class History {
  constructor(names, length) {
    this.length = length;
    this.count = 0;
    this.rows = Object.fromEntries(names.map((name) => [name, new Float64Array(length)]));
  }

  add(values) {
    const place = this.count++ % this.length;
    for (const [name, row] of Object.entries(this.rows)) row[place] = values[name];
  }

  /** Values of a signal `back` samples ago; NaN before the start. */
  back(name, back) {
    return back < Math.min(this.count, this.length) ? this.rows[name][(this.count - 1 - back) % this.length] : NaN;
  }
}

/** A step of 1, 2 or 5 times a power of ten that divides a span into at most so many parts. */
function niceStep(span, parts) {
  const power = 10 ** Math.floor(Math.log10(span / parts));
  return [1, 2, 5, 10].map((factor) => factor * power).find((step) => step * parts >= span * (1 - 1e-9));
}

/**
 * Draw a panel.
 * panel: title, low and high (fixed ends; else from the lines), least (smallest span), lines [{name, colour, dash, width}],
 * marks (fixed horizontal lines). time: seconds now; period: s between samples.
 */
function drawPanel(canvas, panel, history, time, period, theme, changes) {
  const { context: c, width, height } = prepared(canvas);
  const [left, right, top, bottom] = [40, width - 8, 24, height - 22];
  const seconds = history.length * period;
  let [low, high] = [panel.low, panel.high];
  if (low === undefined) {
    [low, high] = [Infinity, -Infinity];
    for (const { name } of panel.lines)
      for (let back = 0; back < Math.min(history.count, history.length); back += 2) {
        const value = history.back(name, back);
        if (value < low) low = value;
        if (value > high) high = value;
      }
    if (!(high >= low)) [low, high] = [0, 0];
    const spare = Math.max(panel.least - (high - low), 0.06 * (high - low)) / 2;
    [low, high] = [low - spare, high + spare];
  }
  const x = (back) => right - (back * period * (right - left)) / seconds;
  const y = (value) => bottom - ((value - low) * (bottom - top)) / (high - low);

  c.font = "11px system-ui, sans-serif";
  c.lineWidth = 1;
  const step = niceStep(high - low, 4);
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  for (let value = Math.ceil(low / step) * step; value <= high + 1e-9 * step; value += step) {
    c.strokeStyle = theme.grid;
    c.beginPath();
    c.moveTo(left, Math.round(y(value)) + 0.5);
    c.lineTo(right, Math.round(y(value)) + 0.5);
    c.stroke();
    c.fillStyle = theme.soft;
    c.textAlign = "right";
    c.fillText(number(value, digits), left - 6, y(value) + 4);
  }
  c.textAlign = "center";
  for (let second = Math.ceil(time - seconds); second <= time; second += width < 380 ? 2 : 1) {
    const place = right - ((time - second) * (right - left)) / seconds;
    if (second >= 0 && place > left + 4 && place < right - 4) c.fillText(`${second}`, place, bottom + 15);
  }
  c.textAlign = "left";
  c.fillText("s", right - 4, bottom + 15);
  c.fillStyle = theme.ink;
  c.font = "600 12px system-ui, sans-serif";
  c.fillText(panel.title, 4, 14, width - 8);

  c.save();
  c.beginPath();
  c.rect(left, top - 2, right - left, bottom - top + 4);
  c.clip();
  c.setLineDash([2, 3]);
  c.strokeStyle = theme.soft;
  for (const change of changes) {
    const place = right - ((time - change) * (right - left)) / seconds;
    c.beginPath();
    c.moveTo(place, top);
    c.lineTo(place, bottom);
    c.stroke();
  }
  for (const mark of panel.marks || []) {
    c.beginPath();
    c.moveTo(left, y(mark));
    c.lineTo(right, y(mark));
    c.stroke();
  }
  const stride = Math.max(1, Math.floor(history.length / (1.5 * (right - left))));
  const first = (history.count - 1) % stride; // the same samples from frame to frame, so that lines do not flicker
  for (const { name, colour, dash, width: thick } of panel.lines) {
    c.strokeStyle = colour;
    c.lineWidth = thick || 1.6;
    c.setLineDash(dash || []);
    c.beginPath();
    let begun = false;
    for (let back = first; back < Math.min(history.count, history.length); back += stride) {
      const value = history.back(name, back);
      if (Number.isNaN(value)) break;
      if (begun) c.lineTo(x(back), y(value));
      else c.moveTo(x(back), y(value));
      begun = true;
    }
    c.stroke();
  }
  c.restore();
}
