"use strict";
// Charts drawn by uPlot: lines of one run or of several that share a cursor and a zoom, their pictures, and bars. Colours
// are the page's variables.
const CHART_HEIGHT = 150;
const STRIP_HEIGHT = 62;
// Points that are further apart, in seconds, are not joined.
const APART_S = 2;
// Nobody zooms in further than this: a few telemetries, in seconds or metres.
const LEAST = 1;
// Steps of a clock.
const CLOCK_S = [0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 1200, 1800, 3600, 7200, 14400, 86400];
// Paper is light.
const dark = matchMedia("screen and (prefers-color-scheme: dark)");
// Every chart of the page, for when the colours change.
const drawn = new Set();
dark.addEventListener("change", () => drawn.forEach((u) => u.redraw(false)));

const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const colour = (name) => () => css(name);
const number = (value) => String(+value.toFixed(6));

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

// A chart in its box, as wide as that; `read` says in words what stands at the cursor, `move` puts it at a pixel.
function chart(box, title, data, read, move, { axes, hooks, height = CHART_HEIGHT, ...options }) {
  const readout = el("div", { class: "readout" });
  const axis = { stroke: colour("--faint"), font: "11px system-ui, sans-serif", ticks: { show: false }, gap: 4 };
  const says = (u) => {
    const words = u.cursor.left >= 0 ? read(u) : "";
    readout.textContent = words;
    u.root.setAttribute("aria-valuetext", words);
    u.root.setAttribute("aria-valuenow", u.data[0][u.cursor.idx] ?? u.scales.x.min);
  };
  const u = new uPlot({
    width: 600, height, padding: [8, 22, 0, 0], legend: { show: false }, ...options,
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
  new ResizeObserver(([{ contentRect: { width } }]) => width && u.setSize({ width, height })).observe(box);
  drawn.add(u);
  return u;
}

// The points of a line, with a hole where the run says nothing for a while; where x stands still, the newest.
function points(run, ys, ts) {
  const xs = [], values = [];
  ts.forEach((t, i) => {
    const x = run.x(t);
    if (i && t - ts[i - 1] > APART_S) { xs.push((xs.at(-1) + x) / 2); values.push(null); }
    if (xs.length && x <= xs.at(-1)) { values[values.length - 1] = ys[i]; return; }
    xs.push(x); values.push(ys[i]);
  });
  return [xs, values];
}

// Charts of runs that lie over one another, along one axis. Each run has `x(t)`, where a time lies on the axis, `t(x)`,
// the time there, a `mark` and a `colour`; `follow` is told what lies under the cursor, or null.
function chartsOf(shown, axis, key, follow) {
  const charts = [], several = shown.length > 1;
  const marks = shown.flatMap((run) => run.drawn.events.filter(({ kind }) => !["lap", "run-ended"].includes(kind))
    .map(({ t, words }) => ({ x: run.x(t), words: several ? `${run.mark}: ${words}` : words })));
  const ends = shown.flatMap((run) => [...run.drawn.t, ...run.drawn.answers.map(([t]) => t)].map(run.x));
  const [start, end] = extent(ends), whole = [Math.max(0, start), end];
  let at = null;
  const zoom = ([min, max]) => charts.forEach((u) => {
    u.setScale("x", { min, max });
    u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
  });
  const zoomTo = (from, to) => {
    const more = Math.max(0, LEAST - (to - from)) / 2;
    zoom([Math.max(whole[0], from - more), Math.min(whole[1], to + more)]);
  };
  const show = (x) => charts.forEach((u) => u.setCursor({ left: u.valToPos(x, "x"), top: 0 }, true));
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
    for (const x of marks.map(({ x }) => valToPos(x, "x", true))) {
      if (x < bbox.left || x > bbox.left + bbox.width) continue;
      ctx.moveTo(x, bbox.top); ctx.lineTo(x, bbox.top + bbox.height);
    }
    ctx.stroke();
    ctx.restore();
  }
  // A chart along the axis.
  function along(title, data, read, options) {
    const box = el("div", { class: "chart" }, el("h3", {}, title));
    const first = charts.length === 0;
    const says = (u) => {
      const x = u.posToVal(u.cursor.left, "x");
      const near = marks.filter((mark) => Math.abs(u.valToPos(mark.x, "x") - u.cursor.left) < 4).map(({ words }) => words);
      return [`${axis.words(x)}: ${read(x)}`, ...near].join(" · ");
    };
    const u = chart(box, title, data, says, move, {
      ...options,
      scales: { x: { time: false, min: whole[0], max: whole[1], auto: false }, ...options.scales },
      axes: [{ space: 60, ...axis.ticks }, options.axis],
      cursor: {
        y: false, points: { show: several ? false : undefined },
        drag: { x: true, y: false, setScale: false, dist: 4 },
        sync: { key, scales: ["x", null], filters: { pub: (type) => type === "mousemove" } },
        bind: { dblclick: () => () => (zoom(whole), null) },
        ...options.cursor,
      },
      hooks: {
        ...options.hooks, setSelect: [selected],
        setCursor: first ? [(u) => { at = u.cursor.left >= 0 ? u.posToVal(u.cursor.left, "x") : null; follow(at); }] : [],
      },
    });
    charts.push(u);
    u.root.addEventListener("keydown", ({ key, altKey, ctrlKey, metaKey }) => {
      const { min, max } = u.scales.x, reach = { "+": (max - min) / 4, "-": max - min, Escape: Infinity }[key];
      if (!reach || altKey || ctrlKey || metaKey) return;
      const middle = at ?? (min + max) / 2, kept = at;
      zoomTo(middle - reach, middle + reach);
      // uPlot zooms in a microtask; the cursor stays at its place.
      if (kept !== null) queueMicrotask(() => show(kept));
    });
    return box;
  }
  // A line of each run, from zero; the title alone where none tells anything of it.
  function over(title, unit, name, of) {
    const lines = shown.map((run) => ({ run, ...of(run) })).filter(({ ys }) => ys.some((value) => value !== null));
    if (!lines.length) return title;
    const tables = lines.map(({ run, ys, ts }) => points(run, ys, ts));
    const data = tables.length === 1 ? tables[0] : uPlot.join(tables);
    const value = ({ run, ts, ys }, x) => {
      const t = run.t(x), i = before(ts, t), next = Math.min(i + 1, ts.length - 1);
      const near = Math.abs(ts[next] - t) < Math.abs(ts[i] - t) ? next : i;
      return Math.abs(ts[near] - t) > APART_S || (ys[near] ?? null) === null ? "not reported" : `${ys[near].toFixed(2)} ${unit}`;
    };
    const read = (x) => lines.map((line) => (several ? `${line.run.mark} ` : "") + value(line, x)).join(", ");
    const ink = (run) => (several ? () => run.colour : colour(name));
    return along(title, data, read, {
      scales: { y: { range: (_, low, high) => fromZero(low, high) } },
      axis: { values: (_, splits) => splits.map(number) },
      series: [{}, ...lines.map(({ run }) => ({ stroke: ink(run), width: 1.4, pxAlign: 0, points: { size: 4, space: 14, fill: ink(run) } }))],
      hooks: { drawAxes: [drawMarks] },
    });
  }
  // The pictures of a run, one beside another along the axis: of what is zoomed into, as many as there is room for.
  function strip(run, title) {
    const { frames } = run.drawn;
    if (!frames?.length) return title;
    const [ts, sources] = [frames.map(([t]) => t), frames.map(([, jpeg]) => "data:image/jpeg;base64," + jpeg)];
    const images = new Map();
    let u = null;
    const picture = (i) => {
      if (!images.has(i)) {
        const image = new Image();
        images.set(i, image);
        image.addEventListener("load", () => u?.redraw(false));
        image.src = sources[i];
      }
      return images.get(i);
    };
    function paint({ ctx, bbox, posToVal, scales }) {
      const height = bbox.height, wide = Math.max(1, Math.round(bbox.width / (2 * height)));
      for (let k = 0; k < wide; k++) {
        const x = scales.x.min + ((k + 0.5) / wide) * (scales.x.max - scales.x.min), t = run.t(x);
        if (t > ts.at(-1) + APART_S) continue;
        const image = picture(before(ts, t));
        if (!image.complete || !image.naturalWidth) continue;
        const [left, right] = [k, k + 1].map((edge) => bbox.left + Math.round((edge * bbox.width) / wide));
        // Cut to its place, from the middle.
        const shape = (right - left - 2) / height, whole = image.naturalWidth / image.naturalHeight;
        const [w, h] = shape < whole ? [image.naturalHeight * shape, image.naturalHeight] : [image.naturalWidth, image.naturalWidth / shape];
        ctx.drawImage(image, (image.naturalWidth - w) / 2, (image.naturalHeight - h) / 2, w, h, left, bbox.top, right - left - 2, height);
      }
    }
    const table = points(run, ts.map(() => 0), ts);
    const box = along(title, table, (x) => `picture of ${clock(ts[before(ts, run.t(x))])}`, {
      height: STRIP_HEIGHT + 30, scales: { y: { range: [0, 1] } },
      axis: { values: () => [], grid: { show: false } },
      series: [{}, { stroke: "transparent", points: { show: false } }],
      cursor: { points: { show: false } },
      hooks: { drawAxes: [paint] },
    });
    u = charts.at(-1);
    return box;
  }
  return { over, strip, show: (x) => charts.length && show(x), unzoom: () => zoom(whole) };
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
  const read = ({ cursor: { idx } }) => `${(middles[idx] - width / 2).toFixed(2)} to ${(middles[idx] + width / 2).toFixed(2)} ${unit}: ${shares[idx].toFixed(1)} %`;
  chart(box, title, [middles, shares], read, (u, left) => u.setCursor({ left, top: 0 }, true), {
    scales: { x: { time: false, range: [-reach, reach] }, y: { range: [0, Math.max(...shares)] } },
    axes: [{ values: (_, splits) => splits.map((value) => `${number(value)} ${unit}`) },
      { values: (_, splits) => splits.map((value) => `${number(value)} %`) }],
    series: [{}, { fill: colour("--a"), paths: uPlot.paths.bars({ size: [1, Infinity], gap: 1 }), points: { show: false } }],
    cursor: { y: false, drag: { x: false, y: false }, points: { show: false } },
  });
  return box;
}
