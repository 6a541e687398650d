"use strict";
// What reports and the live page have in common: elements, clocks, places in a series, and a road from above.

// A car that is further from where it was a telemetry before was put there, in metres: `car::PUT_M`.
const PUT_M = 20;

function el(tag, attributes = {}, ...children) {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  node.append(...children);
  return node;
}

function clock(t) {
  const tenths = Math.round(10 * t), minutes = Math.floor(tenths / 600);
  return minutes + ":" + ((tenths - 600 * minutes) / 10).toFixed(1).padStart(4, "0");
}

// Index of the last value that is not after x; 0 where all are. Times of several series may differ by their rounding.
function before(values, x) {
  let low = 0, high = values.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (values[middle] <= x + 1e-6) low = middle; else high = middle - 1;
  }
  return low;
}

// The value at x of a line through these points; beyond its ends, that of the end.
function between(xs, ys, x) {
  const i = before(xs, x), next = Math.min(i + 1, xs.length - 1), span = xs[next] - xs[i];
  return span > 0 && x > xs[i] ? ys[i] + Math.min(1, (x - xs[i]) / span) * (ys[next] - ys[i]) : ys[i] ?? 0;
}

// The road as one broad stroke along its middle, so that it has no hole where it crosses itself; its edges are what a broader
// stroke leaves. `place` says where in the picture a point is, `scale` how many pixels a metre has.
function drawRoad(pen, { left, right }, place, scale, edge, surface) {
  const middle = left.map(([x, z], i) => place([(x + right[i][0]) / 2, (z + right[i][1]) / 2]));
  const width = scale * Math.hypot(left[0][0] - right[0][0], left[0][1] - right[0][1]);
  pen.lineJoin = "round";
  for (const [ink, wide] of [[edge, width + 2], [surface, width]]) {
    pen.strokeStyle = ink;
    pen.lineWidth = Math.max(wide, 3);
    pen.beginPath();
    middle.forEach(([x, y]) => pen.lineTo(x, y));
    pen.closePath();
    pen.stroke();
  }
}
