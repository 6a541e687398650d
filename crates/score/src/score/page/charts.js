"use strict";
// Charts drawn by uPlot: lines over time that share a cursor and a zoom, and bars. Colours are the page's variables.
const CHART_HEIGHT = 150;
// Points that are further apart, in seconds, are not joined.
const APART_S = 2;
// Nobody zooms in further than this, in seconds: a few telemetries.
const LEAST_S = 1;
// Steps of a clock.
const CLOCK_S = [0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 1200, 1800, 3600, 7200, 14400, 86400];
// Paper is light.
const dark = matchMedia("screen and (prefers-color-scheme: dark)");

const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const colour = (name) => () => css(name);
const number = (value) => String(+value.toFixed(6));

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

function extent(values, ...also) {
  let low = Infinity, high = -Infinity;
  for (const value of values) if (value !== null) { low = Math.min(low, value); high = Math.max(high, value); }
  for (const value of also) { low = Math.min(low, value); high = Math.max(high, value); }
  return low > high ? [0, 1] : low === high ? [low - 1, high + 1] : [low, high];
}

// The range of an axis that has zero on it, with some room beyond the values.
function fromZero(low, high) {
  const [least, most] = extent(low === null ? [] : [low, high], 0), room = 0.05 * (most - least);
  return [least < 0 ? least - room : 0, most > 0 ? most + room : 0];
}

// A chart in its box, as wide as that; `read` says in words what stands at an index, or at the cursor where nothing
// stands, `move` puts the cursor at a pixel.
function chart(box, title, data, read, move, { axes, hooks, ...options }) {
  const readout = el("div", { class: "readout" });
  const axis = { stroke: colour("--faint"), font: "11px system-ui, sans-serif", ticks: { show: false }, gap: 4 };
  const says = (u) => {
    const words = u.cursor.left >= 0 ? read(u, u.cursor.idxs[1]) : "";
    readout.textContent = words;
    u.root.setAttribute("aria-valuetext", words);
    u.root.setAttribute("aria-valuenow", u.data[0][u.cursor.idx] ?? u.scales.x.min);
  };
  const u = new uPlot({
    width: 600, height: CHART_HEIGHT, padding: [8, 22, 0, 0], legend: { show: false }, ...options,
    axes: [{ ...axis, size: 22, grid: { show: false }, ...axes[0] },
      { ...axis, size: 46, space: 24, grid: { stroke: colour("--line"), width: 1 }, ...axes[1] }],
    hooks: { ...hooks, setCursor: [says, ...(hooks?.setCursor ?? [])] },
  }, data, box);
  box.append(readout);
  const [least, most] = extent(data[0]);
  const slider = { role: "slider", tabindex: 0, "aria-label": title, "aria-valuemin": least, "aria-valuemax": most, "aria-valuenow": least };
  for (const [name, value] of Object.entries(slider)) u.root.setAttribute(name, value);
  // A mouse is uPlot's own; a finger reads along the chart, and scrolls the page up and down.
  u.over.addEventListener("pointermove", (event) => {
    if (event.pointerType !== "mouse") move(u, event.clientX - u.over.getBoundingClientRect().left);
  });
  const steps = { ArrowLeft: (i) => i - 1, ArrowRight: (i) => i + 1, Home: () => 0, End: () => Infinity };
  u.root.addEventListener("keydown", (event) => {
    const step = steps[event.key];
    if (!step || event.altKey || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    const [first, last] = u.series[0].idxs;
    const at = step(u.cursor.idx ?? (event.key === "ArrowLeft" ? last + 1 : first - 1));
    const left = u.valToPos(u.data[0][Math.min(last, Math.max(first, at))], "x");
    move(u, Math.min(u.over.clientWidth, Math.max(0, left)));
  });
  new ResizeObserver(([{ contentRect: { width } }]) => width && u.setSize({ width, height: CHART_HEIGHT })).observe(box);
  dark.addEventListener("change", () => u.redraw(false));
  return u;
}

// Charts of one run: `over` adds a line, `follow` is told the time under the cursor, or null.
function chartsOfRun(run, key, follow) {
  const charts = [];
  const marks = run.drawn.events.filter((event) => !["lap", "run-ended"].includes(event.kind));
  const [start, end] = extent([...run.drawn.t, ...run.drawn.answers.map(([t]) => t)]), whole = [Math.max(0, start), end];
  const zoom = ([min, max]) => charts.forEach((u) => {
    u.setScale("x", { min, max });
    u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
  });
  const zoomTo = (from, to) => {
    const more = Math.max(0, LEAST_S - (to - from)) / 2;
    zoom([Math.max(whole[0], from - more), Math.min(whole[1], to + more)]);
  };
  const show = (t) => charts.forEach((u) => u.setCursor({ left: u.valToPos(t, "x"), top: 0 }, true));
  const move = (u, left) => show(u.posToVal(left, "x"));
  const selected = (u) => {
    const { left, width } = u.select;
    if (width > 0) zoomTo(u.posToVal(left, "x"), u.posToVal(left + width, "x"));
  };
  function drawMarks({ ctx, bbox, valToPos }) {
    const ratio = uPlot.pxRatio;
    ctx.save();
    ctx.strokeStyle = css("--bad"); ctx.globalAlpha = 0.7; ctx.lineWidth = ratio; ctx.setLineDash([3 * ratio, 3 * ratio]);
    ctx.beginPath();
    for (const x of marks.map(({ t }) => valToPos(t, "x", true))) {
      if (x < bbox.left || x > bbox.left + bbox.width) continue;
      ctx.moveTo(x, bbox.top); ctx.lineTo(x, bbox.top + bbox.height);
    }
    ctx.stroke();
    ctx.restore();
  }
  // Where time jumps, beside where nothing is told.
  function gaps(u, _, first, last, untold) {
    const [t] = u.data;
    for (let i = Math.max(1, first); i <= last; i++) {
      if (t[i] - t[i - 1] > APART_S) uPlot.addGap(untold, Math.round(u.valToPos(t[i - 1], "x", true)), Math.round(u.valToPos(t[i], "x", true)));
    }
    return untold.sort((a, b) => a[0] - b[0]);
  }
  // A line over time, from zero; the title alone where a run tells nothing of it.
  function over(title, ts, ys, unit, name) {
    if (!ys.some((value) => value !== null)) return title;
    const box = el("div", { class: "chart" }, el("h3", {}, title));
    const read = (u, i) => {
      const value = (ys[i] ?? null) === null ? "not reported" : `${ys[i].toFixed(2)} ${unit}`;
      const near = marks.filter(({ t }) => Math.abs(u.valToPos(t, "x") - u.cursor.left) < 4).map(({ words }) => words);
      return [`${clock(ts[i] ?? u.posToVal(u.cursor.left, "x"))}: ${value}`, ...near].join(" · ");
    };
    const first = charts.length === 0;
    const u = chart(box, title, [ts, ys], read, move, {
      scales: { x: { time: false, min: whole[0], max: whole[1], auto: false }, y: { range: (_, low, high) => fromZero(low, high) } },
      axes: [{ incrs: CLOCK_S, space: 60, values: (_, splits) => splits.map((t) => clock(t).replace(/\.0$/, "")) },
        { values: (_, splits) => splits.map(number) }],
      series: [{}, { stroke: colour(name), width: 1.4, pxAlign: 0, gaps, points: { size: 4, space: 14, fill: colour(name) } }],
      cursor: {
        y: false, dataIdx: (_, __, i, t) => (Math.abs(ts[i] - t) > APART_S ? null : i),
        drag: { x: true, y: false, setScale: false, dist: 4 },
        sync: { key, scales: ["x", null], filters: { pub: (type) => type === "mousemove" } },
        bind: { dblclick: () => () => (zoom(whole), null) },
      },
      hooks: {
        drawAxes: [drawMarks], setSelect: [selected],
        setCursor: first ? [({ cursor: { left, idxs } }) => follow(left >= 0 ? ts[idxs[1]] ?? null : null)] : [],
      },
    });
    charts.push(u);
    u.root.addEventListener("keydown", ({ key, altKey, ctrlKey, metaKey }) => {
      const { min, max } = u.scales.x, reach = { "+": (max - min) / 4, "-": max - min, Escape: Infinity }[key];
      if (!reach || altKey || ctrlKey || metaKey) return;
      const middle = ts[u.cursor.idx] ?? (min + max) / 2;
      zoomTo(middle - reach, middle + reach);
      // uPlot zooms in a microtask; the cursor stays at its time.
      if (typeof u.cursor.idx === "number") queueMicrotask(() => show(middle));
    });
    return box;
  }
  return { over };
}

// Shares of the values, in percent, of bins that reach as far to both sides.
function histogram(title, values, unit) {
  if (!values.length) return title;
  const box = el("div", { class: "chart" }, el("h3", {}, title));
  const [low, high] = extent(values);
  const reach = Math.max(0.5, Math.ceil(10 * Math.max(-low, high)) / 10), bins = 40, width = (2 * reach) / bins;
  const shares = new Array(bins).fill(0);
  for (const value of values) shares[Math.min(bins - 1, Math.floor((value + reach) / width))] += 100 / values.length;
  const middles = shares.map((_, i) => -reach + (i + 0.5) * width);
  const read = (_, i) => `${(middles[i] - width / 2).toFixed(2)} to ${(middles[i] + width / 2).toFixed(2)} ${unit}: ${shares[i].toFixed(1)} %`;
  chart(box, title, [middles, shares], read, (u, left) => u.setCursor({ left, top: 0 }, true), {
    scales: { x: { time: false, range: [-reach, reach] }, y: { range: [0, Math.max(...shares)] } },
    axes: [{ values: (_, splits) => splits.map((value) => `${number(value)} ${unit}`) },
      { values: (_, splits) => splits.map((value) => `${number(value)} %`) }],
    series: [{}, { fill: colour("--a"), paths: uPlot.paths.bars({ size: [1, Infinity], gap: 1 }), points: { show: false } }],
    cursor: { y: false, drag: { x: false, y: false }, points: { show: false } },
  });
  return box;
}
