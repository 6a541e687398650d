"use strict";
// Draws the page from the data in it. Everything a run says may be missing: null is "not measurable".
const { runs, figures } = JSON.parse(document.getElementById("data").textContent);
const main = document.getElementById("main");
const by = document.getElementById("by");
const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

function el(tag, attributes = {}, ...children) {
  const svg = ["svg", "g", "line", "path", "text", "rect"].includes(tag);
  const node = svg ? document.createElementNS("http://www.w3.org/2000/svg", tag) : document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  node.append(...children);
  return node;
}

const DECIMALS = { "": 0, "%": 1, m: 2, s: 1, mph: 2, lock: 4, lock2: 5 };
function show(figure, value) {
  if (value === null || value === undefined) return "–";
  if (figure.unit === "%") return (100 * value).toFixed(1) + " %";
  const digits = DECIMALS[figure.unit] ?? 2;
  const whole = Number.isInteger(value) && figure.unit === "";
  return (whole ? String(value) : value.toFixed(figure.unit === "" ? 2 : digits)) + (figure.unit ? " " + figure.unit : "");
}

function clock(t) {
  const minutes = Math.floor(t / 60);
  return minutes + ":" + (t - 60 * minutes).toFixed(1).padStart(4, "0");
}

// Round numbers about `count` steps apart.
function ticks(low, high, count) {
  const rough = (high - low) / count || 1;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((k) => k * power).find((k) => k >= rough);
  const list = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9; k++) list.push([k * step, step]);
  return list;
}
const label = ([value, step]) => value.toFixed(Math.max(0, -Math.floor(Math.log10(step) + 1e-9)));

const WIDTH = 640, LEFT = 44, RIGHT = 18, TOP = 8, BOTTOM = 22;

function frame(height, [x0, x1], [y0, y1], xText = label, yText = label) {
  const x = (value) => LEFT + ((WIDTH - LEFT - RIGHT) * (value - x0)) / (x1 - x0 || 1);
  const y = (value) => height - BOTTOM - ((height - TOP - BOTTOM) * (value - y0)) / (y1 - y0 || 1);
  const svg = el("svg", { viewBox: `0 0 ${WIDTH} ${height}` });
  for (const tick of ticks(y0, y1, 4)) {
    svg.append(el("line", { class: "axis", x1: LEFT, x2: WIDTH - RIGHT, y1: y(tick[0]), y2: y(tick[0]) }));
    svg.append(el("text", { x: LEFT - 6, y: y(tick[0]) + 4, "text-anchor": "end" }, yText(tick)));
  }
  for (const tick of ticks(x0, x1, 8)) {
    svg.append(el("text", { x: x(tick[0]), y: height - 6, "text-anchor": "middle" }, xText(tick)));
  }
  return { svg, x, y };
}

function extent(values, ...also) {
  let low = Infinity, high = -Infinity;
  for (const value of values) if (value !== null) { low = Math.min(low, value); high = Math.max(high, value); }
  for (const value of also) { low = Math.min(low, value); high = Math.max(high, value); }
  return low > high ? [0, 1] : low === high ? [low - 1, high + 1] : [low, high];
}

function path(xs, ys, x, y) {
  let text = "", pen = "M";
  for (let i = 0; i < xs.length; i++) {
    if (ys[i] === null || (i > 0 && xs[i] - xs[i - 1] > 2)) pen = "M";
    if (ys[i] === null) continue;
    text += `${pen}${x(xs[i]).toFixed(1)} ${y(ys[i]).toFixed(1)}`;
    pen = "L";
  }
  return text;
}

// Index of the last time that is not after t.
function before(times, t) {
  let low = 0, high = times.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (times[middle] <= t) low = middle; else high = middle - 1;
  }
  return low;
}

function overTime(run, title, ys, unit, colour, ...also) {
  const { t, events } = run.drawn;
  if (!ys.some((value) => value !== null)) return title;
  const box = el("div", {}, el("h3", {}, title));
  const [t0, t1] = extent(t);
  const { svg, x, y } = frame(120, [t0, t1], extent(ys, ...also), ([value]) => clock(value).replace(/\.0$/, ""));
  for (const event of events) {
    if (["lap", "run-ended"].includes(event.kind)) continue;
    svg.append(el("line", { class: "mark", x1: x(event.t), x2: x(event.t), y1: TOP, y2: 120 - BOTTOM }));
  }
  svg.append(el("path", { d: path(t, ys, x, y), fill: "none", stroke: colour, "stroke-width": 1.4 }));
  const cursor = el("line", { class: "cursor", y1: TOP, y2: 120 - BOTTOM, visibility: "hidden" });
  const readout = el("div", { class: "readout" });
  svg.append(cursor);
  svg.addEventListener("mousemove", (event) => {
    const place = svg.getBoundingClientRect();
    const px = ((event.clientX - place.left) / place.width) * WIDTH;
    const at = before(t, t0 + ((px - LEFT) / (WIDTH - LEFT - RIGHT)) * (t1 - t0));
    for (const end of ["x1", "x2"]) cursor.setAttribute(end, x(t[at]));
    cursor.setAttribute("visibility", "visible");
    readout.textContent = `${clock(t[at])}: ${ys[at] === null ? "not told" : ys[at].toFixed(2) + " " + unit}`;
  });
  box.append(svg, readout);
  return box;
}

function histogram(run) {
  const offsets = run.drawn.cte.filter((value) => value !== null);
  const title = "Offset from the line, share of the telemetries";
  if (!offsets.length) return title;
  const box = el("div", {}, el("h3", {}, title));
  const [low, high] = extent(offsets);
  const reach = Math.max(0.5, Math.ceil(10 * Math.max(-low, high)) / 10), bins = 40, width = (2 * reach) / bins;
  const counts = new Array(bins).fill(0);
  for (const value of offsets) counts[Math.min(bins - 1, Math.floor((value + reach) / width))]++;
  const most = Math.max(...counts) / offsets.length;
  const { svg, x, y } = frame(130, [-reach, reach], [0, 100 * most], (tick) => label(tick) + " m", (tick) => label(tick) + " %");
  counts.forEach((count, i) => {
    const top = y((100 * count) / offsets.length);
    svg.append(el("rect", { x: x(-reach + i * width) + 0.5, width: Math.max(1, x(width) - x(0) - 1), y: top, height: y(0) - top, fill: css("--a") }));
  });
  box.append(svg);
  return box;
}

function latency(run) {
  const { answers } = run.drawn;
  const title = "Time to answer, ms (slowest of each few)";
  if (!answers.length) return title;
  const box = el("div", {}, el("h3", {}, title));
  const [ts, ms] = [answers.map((a) => a[0]), answers.map((a) => a[1])];
  const { svg, x, y } = frame(120, extent(ts), extent(ms, 0), ([value]) => clock(value).replace(/\.0$/, ""));
  svg.append(el("path", { d: path(ts, ms, x, y), fill: "none", stroke: css("--b"), "stroke-width": 1 }));
  const stages = Object.entries(run.card.latency_ms).map(([stage, q]) =>
    el("tr", {}, el("td", {}, stage), ...[q.p50, q.p95, q.p99].map((v) => el("td", {}, v.toFixed(2)))));
  const head = el("thead", {}, el("tr", {}, ...["stage", "p50 ms", "p95 ms", "p99 ms"].map((name) => el("th", {}, name))));
  box.append(svg, el("table", {}, head, el("tbody", {}, ...stages)));
  return box;
}

// Dark blue over green to yellow: read alike by everybody, and in grey.
const SCALE = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];
function colour(share) {
  const place = Math.min(0.9999, Math.max(0, share)) * (SCALE.length - 1), i = Math.floor(place), part = place - i;
  return `rgb(${SCALE[i].map((value, k) => Math.round(value + part * (SCALE[i + 1][k] - value))).join(",")})`;
}

function map(run) {
  const { at, events, t } = run.drawn;
  const told = at.filter((place) => place !== null);
  if (!told.length) return "From above";
  const guessed = run.drawn.on_line ? " (estimated: how far along the road, not where across it)" : "";
  const box = el("div", {}, el("h3", {}, "From above" + guessed));
  const canvas = el("canvas"), bar = el("i"), least = el("span"), most = el("span");
  box.append(canvas, el("div", { class: "legend" }, least, bar, most));
  const road = run.outline ? [...run.outline.left, ...run.outline.right] : [];
  const all = [...told, ...road];
  const [x0, x1] = extent(all.map((p) => p[0])), [z0, z1] = extent(all.map((p) => p[1]));
  const draw = () => {
    const ratio = devicePixelRatio || 1, width = canvas.clientWidth || 600;
    const height = Math.min(width, 520, Math.max(180, (width * (z1 - z0)) / (x1 - x0)));
    canvas.width = width * ratio; canvas.height = height * ratio; canvas.style.height = height + "px";
    const pad = 16, scale = Math.min((width - 2 * pad) / (x1 - x0), (height - 2 * pad) / (z1 - z0));
    const px = (x) => width / 2 + (x - (x0 + x1) / 2) * scale, py = (z) => height / 2 - (z - (z0 + z1) / 2) * scale;
    const pen = canvas.getContext("2d");
    pen.scale(ratio, ratio);
    if (run.outline) {
      const { left, right } = run.outline;
      pen.fillStyle = css("--road");
      pen.beginPath();
      for (const edge of [left, right]) {
        edge.forEach(([x, z], i) => (i ? pen.lineTo(px(x), py(z)) : pen.moveTo(px(x), py(z))));
        pen.closePath();
      }
      pen.fill("evenodd");
    }
    const offset = by.value === "cte" && run.drawn.cte.some((value) => value !== null);
    const values = offset ? run.drawn.cte.map((value) => (value === null ? null : Math.abs(value))) : run.drawn.speed;
    const [low, high] = extent(values, 0);
    pen.lineWidth = 2.5; pen.lineCap = "round";
    for (let i = 1; i < at.length; i++) {
      const [from, to] = [at[i - 1], at[i]];
      // A car that is put elsewhere leaves no line.
      if (!from || !to || Math.hypot(to[0] - from[0], to[1] - from[1]) > 12 || t[i] - t[i - 1] > 2) continue;
      pen.strokeStyle = values[i] === null ? css("--faint") : colour((values[i] - low) / (high - low));
      pen.beginPath(); pen.moveTo(px(from[0]), py(from[1])); pen.lineTo(px(to[0]), py(to[1])); pen.stroke();
    }
    for (const event of events) {
      if (!["collision", "off-road", "stuck", "takeover-began", "bad-frame", "note"].includes(event.kind)) continue;
      const place = at[before(t, event.t)];
      if (!place) continue;
      pen.fillStyle = css("--bad"); pen.strokeStyle = css("--card"); pen.lineWidth = 2;
      pen.beginPath(); pen.arc(px(place[0]), py(place[1]), 5, 0, 7); pen.fill(); pen.stroke();
    }
    bar.style.background = `linear-gradient(90deg, ${SCALE.map((c) => `rgb(${c})`).join(",")})`;
    const unit = offset ? "m off the line" : "mph";
    least.textContent = low.toFixed(offset ? 2 : 1); most.textContent = `${high.toFixed(offset ? 2 : 1)} ${unit}`;
  };
  by.addEventListener("change", draw);
  addEventListener("resize", draw);
  requestAnimationFrame(draw);
  return box;
}

function events(run) {
  const box = el("div", {}, el("h3", {}, "What happened"));
  if (!run.drawn.events.length) return box.append(el("p", { class: "readout" }, "nothing")), box;
  for (const { t, words, pictures } of run.drawn.events) {
    const frames = [...pictures].sort((a, b) => a[0] - b[0]).map(([from, jpeg]) => el("figure", {},
      el("img", { src: "data:image/jpeg;base64," + jpeg, alt: "the camera's picture", loading: "lazy" }),
      el("figcaption", {}, `${from >= 0 ? "+" : "−"}${Math.abs(from).toFixed(1)} s`)));
    box.append(el("div", { class: "event" }, el("time", {}, clock(t)), words, el("div", { class: "frames" }, ...frames)));
  }
  return box;
}

const TILES = ["completion", "collisions", "off_roads", "autonomy", "driving_score", "mean_cte_m", "mean_mph", "steering_rate_deg_s"];
function tiles(run) {
  return el("div", { class: "tiles" }, ...TILES.map((key) => {
    const figure = figures.find((one) => one.key === key);
    const why = run.card.not_measurable[key];
    const estimate = run.card.estimates[key] ? "≈ " : "";
    const title = figure.meaning + (why ? `\nNot measurable: ${why}.` : "");
    return el("div", { class: "tile", title }, el("b", {}, estimate + show(figure, run.card[key])), el("span", {}, figure.label));
  }));
}

function table(shown) {
  const head = el("thead", {}, el("tr", {}, el("th", {}, ""), ...shown.map((run) => el("th", { title: run.title }, run.title))));
  // On different tracks none is the best.
  const comparable = new Set(shown.map((run) => JSON.stringify([run.card.track, run.card.scenario]))).size === 1;
  const told = (figure) => shown.some((run) => run.card[figure.key] !== null);
  const rows = figures.filter(told).map((figure) => {
    const values = shown.map((run) => run.card[figure.key]);
    const known = values.filter((value) => value !== null);
    const best = figure.better === "higher" ? Math.max(...known) : figure.better === "lower" ? Math.min(...known) : NaN;
    const differ = comparable && new Set(known).size > 1;
    const cells = shown.map((run, i) => {
      const why = run.card.not_measurable[figure.key], estimate = run.card.estimates[figure.key];
      const kind = values[i] === null ? "none" : differ && values[i] === best ? "best" : "";
      const title = why ? `Not measurable: ${why}.` : (run.how[figure.key] ?? "").trim();
      return el("td", { class: kind, title }, (estimate ? "≈ " : "") + show(figure, values[i]));
    });
    return el("tr", { title: figure.meaning }, el("td", {}, figure.label), ...cells);
  });
  const others = figures.filter((figure) => !told(figure)).map((figure) =>
    el("span", { title: `${figure.meaning}\nNot measurable: ${shown[0].card.not_measurable[figure.key]}.` }, figure.label));
  const list = others.flatMap((one, i) => (i ? [", ", one] : [one]));
  if (list.length) rows.push(el("tr", { class: "untold" }, el("td", {}, "not told"), el("td", { colspan: shown.length }, ...list)));
  return el("table", {}, head, el("tbody", {}, ...rows));
}

if (runs.length > 1) main.append(el("section", { class: "wide" }, el("h2", {}, "Side by side"), table(runs)));
for (const run of runs) {
  const section = el("section", {}, el("h2", {}, run.title));
  if (run.missed.length) section.append(el("ul", { class: "missed" }, ...run.missed.map((words) => el("li", {}, words))));
  const laps = run.card.lap_times_s.map((s) => s.toFixed(1)).join(", "), off = run.how.lap_times_s ?? "";
  // What a run does not tell is its name alone.
  const parts = [map(run),
    overTime(run, "Speed, mph", run.drawn.speed, "mph", css("--a"), 0),
    overTime(run, "Steering, degrees", run.drawn.steering, "degrees", css("--b"), 0),
    overTime(run, "Offset from the line, m", run.drawn.cte, "m", css("--good"), 0),
    histogram(run), latency(run)];
  const untold = parts.filter((part) => typeof part === "string").join("; ");
  section.append(tiles(run), laps ? el("p", { class: "readout" }, `Lap times: ${laps} s${off}`) : "",
    ...parts.filter((part) => typeof part !== "string"),
    untold ? el("p", { class: "readout" }, `Not told by this run: ${untold}`) : "", events(run));
  if (runs.length === 1) section.append(el("details", {}, el("summary", {}, "All figures"), table(runs)));
  for (const note of run.card.notes) section.append(el("p", { class: "readout" }, "Note: " + note));
  main.append(section);
}
