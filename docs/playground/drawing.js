/* The picture of an axis: cylinder cut open, leak, load, reference and valve. Lengths along the axis are to scale. */
"use strict";

/** Colour between neighbours of a list of [r, g, b], at 0 to 1. */
function between(colours, at) {
  const place = Math.min(Math.max(at, 0), 1) * (colours.length - 1);
  const low = Math.min(Math.floor(place), colours.length - 2);
  const mix = colours[low].map((part, i) => Math.round(part + (place - low) * (colours[low + 1][i] - part)));
  return `rgb(${mix.join(",")})`;
}

/** Prepare a canvas for its size on the screen; returns its context and size in CSS pixels. */
function prepared(canvas) {
  const ratio = Math.min(window.devicePixelRatio || 1, 2);
  const { clientWidth: width, clientHeight: height } = canvas;
  const [wide, high] = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== wide || canvas.height !== high) [canvas.width, canvas.height] = [wide, high];
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return { context, width, height };
}

const bar = (pressure) => pressure / 1e5;
const number = (value, digits) => (Math.abs(value) < 0.5 * 10 ** -digits ? 0 : value).toFixed(digits).replace("-", "−");

/**
 * Draw an axis.
 * seen: position, reference, bias of the sensor, stroke (m), pressures (Pa), supply (Pa), leakFlow (l/min now, from a to b), leak (l/min at
 * 100 bar), spool (-1 to 1), force (N).
 */
function drawAxis(canvas, seen, theme) {
  const { context: c, width } = prepared(canvas);
  const unit = Math.min(width / 360, 1.35);
  const [wall, middle, half] = [6 * unit, 62 * unit, 30 * unit];
  const pixels = (0.4 * width) / seen.stroke; // per metre
  const left = 12 * unit, piston = 12 * unit, bore = seen.stroke * pixels + piston, right = left + bore;
  const at = left + 0.5 * bore + seen.position * pixels;
  const box = (x, y, w, h, fill, edge) => {
    c.fillStyle = fill;
    c.fillRect(x, y, w, h);
    if (edge) {
      c.strokeStyle = edge;
      c.lineWidth = 1;
      c.strokeRect(x, y, w, h);
    }
  };
  const text = (words, x, y, align = "center", colour = theme.ink, size = 12) => {
    c.fillStyle = colour;
    c.font = `${size}px system-ui, sans-serif`;
    c.textAlign = align;
    c.fillText(words, x, y);
  };
  const oil = (pressure) => between(theme.oil, pressure / (1.15 * seen.supply));

  // Cylinder with its two chambers.
  box(left - wall, middle - half - wall, bore + 2 * wall, 2 * (half + wall), theme.steel, theme.edge);
  box(left, middle - half, at - 0.5 * piston - left, 2 * half, oil(seen.pressureA));
  box(at + 0.5 * piston, middle - half, right - at - 0.5 * piston, 2 * half, oil(seen.pressureB));
  const rod = 11 * unit, end = at + 0.5 * piston + 0.53 * bore;
  box(at, middle - rod, end - at, 2 * rod, theme.rod, theme.edge);
  const gap = Math.min(1 + 3 * Math.sqrt(seen.leak), 7) * unit;
  box(at - 0.5 * piston, middle - half + gap, piston, 2 * half - gap, theme.piston, theme.edge);
  box(at - 0.5 * piston, middle - half, piston, gap, theme.leak(seen.leak));
  text(`${number(bar(seen.pressureA), 0)} bar`, left + 6 * unit, middle + half - 8, "left", theme.onOil);
  text(`${number(bar(seen.pressureB), 0)} bar`, right - 6 * unit, middle + half - 8, "right", theme.onOil);

  // The leak, as an arrow over the piston.
  const flow = Math.abs(seen.leakFlow);
  if (flow > 0.02) {
    const way = Math.sign(seen.leakFlow), long = (10 + 12 * Math.min(Math.sqrt(flow), 2)) * unit, y = middle - half + 4 * unit;
    c.strokeStyle = c.fillStyle = theme.leak(seen.leak);
    c.lineWidth = Math.max(gap, 2);
    c.beginPath();
    c.moveTo(at - way * long, y);
    c.lineTo(at + way * (long - 6 * unit), y);
    c.stroke();
    c.beginPath();
    c.moveTo(at + way * (long + 4 * unit), y);
    c.lineTo(at + way * (long - 7 * unit), y - 7 * unit);
    c.lineTo(at + way * (long - 7 * unit), y + 7 * unit);
    c.fill();
  }

  // Load and reference.
  const size = 44 * unit, load = Math.min(end, width - size - 2), ground = middle + 24 * unit;
  box(load, ground - size, size, size, theme.load, theme.edge);
  text(`${number(seen.mass, 0)} kg`, load + 0.5 * size, ground - 0.38 * size, "center", theme.ink, 11);
  c.strokeStyle = theme.edge;
  c.beginPath();
  c.moveTo(right + wall + 3, ground + 0.5);
  c.lineTo(width, ground + 0.5);
  c.stroke();
  const wanted = load + 0.5 * size + (seen.reference - seen.position) * pixels;
  c.fillStyle = theme.reference;
  c.beginPath();
  c.moveTo(wanted, ground - size - 3);
  c.lineTo(wanted - 6, ground - size - 14);
  c.lineTo(wanted + 6, ground - size - 14);
  c.fill();

  // Valve: where the spool stands between its ends.
  const y = middle + half + wall + 22 * unit, centre = left + 0.5 * bore, reach = 0.42 * bore;
  c.strokeStyle = theme.grid;
  c.lineWidth = 4;
  c.beginPath();
  c.moveTo(centre - reach, y);
  c.lineTo(centre + reach, y);
  c.stroke();
  box(centre - 0.5, y - 6, 1, 12, theme.edge);
  box(Math.min(centre, centre + reach * seen.spool), y - 3, Math.abs(reach * seen.spool), 6, theme.accent);
  text(`valve ${number(100 * seen.spool, 0)} %`, centre, y + 18, "center", theme.soft, 11);

  // Error, magnified: the range of the scale is ±1 mm.
  const error = 1e3 * (seen.reference - seen.position - seen.bias), from = right + wall + 14, to = width - 14, zero = 0.5 * (from + to);
  c.strokeStyle = theme.grid;
  c.lineWidth = 4;
  c.beginPath();
  c.moveTo(from, y);
  c.lineTo(to, y);
  c.stroke();
  box(zero - 0.5, y - 6, 1, 12, theme.edge);
  const needle = zero + 0.5 * (to - from) * Math.min(Math.max(error, -1), 1);
  c.fillStyle = theme.accent;
  c.beginPath();
  c.arc(needle, y, 5, 0, 2 * Math.PI);
  c.fill();
  text("−1", from, y + 18, "left", theme.soft, 11);
  text("error, mm", zero, y + 18, "center", theme.soft, 11);
  text("+1", to, y + 18, "right", theme.soft, 11);
}
