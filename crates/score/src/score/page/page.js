"use strict";
// Draws the page from the data in it. Everything a run says may be missing: null is "not measurable".
const { runs, figures } = JSON.parse(document.getElementById("data").textContent);
const main = document.getElementById("main");
const by = document.getElementById("by");

const DECIMALS = { "": 0, "%": 1, m: 2, s: 1, mph: 2, lock: 4, lock2: 5 };
function show(figure, value) {
  if (value === null || value === undefined) return "–";
  if (figure.unit === "%") return (100 * value).toFixed(1) + " %";
  const digits = DECIMALS[figure.unit] ?? 2;
  const whole = Number.isInteger(value) && figure.unit === "";
  return (whole ? String(value) : value.toFixed(figure.unit === "" ? 2 : digits)) + (figure.unit ? " " + figure.unit : "");
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

function latency(run, over) {
  const { answers } = run.drawn;
  const [ts, ms] = [answers.map((a) => a[0]), answers.map((a) => a[1])];
  const box = over("Time to answer, ms (slowest of each few)", ts, ms, "ms", "--b");
  if (typeof box === "string") return box;
  const stages = Object.entries(run.card.latency_ms).map(([stage, q]) =>
    el("tr", {}, el("td", {}, stage), ...[q.p50, q.p95, q.p99].map((v) => el("td", {}, v.toFixed(2)))));
  const head = el("thead", {}, el("tr", {}, ...["stage", "p50 ms", "p95 ms", "p99 ms"].map((name) => el("th", {}, name))));
  box.append(el("table", {}, head, el("tbody", {}, ...stages)));
  return box;
}

// Dark blue over green to yellow: read alike by everybody, and in grey.
const SCALE = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];
function shade(share) {
  const place = Math.min(0.9999, Math.max(0, share)) * (SCALE.length - 1), i = Math.floor(place), part = place - i;
  return `rgb(${SCALE[i].map((value, k) => Math.round(value + part * (SCALE[i + 1][k] - value))).join(",")})`;
}

// The road and the driven line, and `follow`, which shows the car where it was at a time.
function map(run) {
  const { at, events, t } = run.drawn;
  const told = at.filter((place) => place !== null);
  if (!told.length) return { part: "From above", follow: () => {} };
  const guessed = run.drawn.on_line ? " (estimated: how far along the road, not where across it)" : "";
  const box = el("div", {}, el("h3", {}, "From above" + guessed));
  const canvas = el("canvas"), car = el("i", { class: "car", hidden: "" }), bar = el("i"), least = el("span"), most = el("span");
  box.append(el("div", { class: "map" }, canvas, car), el("div", { class: "legend" }, least, bar, most));
  const road = run.outline ? [...run.outline.left, ...run.outline.right] : [];
  const all = [...told, ...road];
  const [x0, x1] = extent(all.map((p) => p[0])), [z0, z1] = extent(all.map((p) => p[1]));
  let shown = null, project = () => [0, 0];
  const follow = (time) => {
    shown = time;
    const place = time === null ? null : at[before(t, time)];
    car.hidden = !place;
    if (place) [car.style.left, car.style.top] = project(place).map((px) => px + "px");
  };
  const draw = () => {
    const ratio = devicePixelRatio || 1, width = canvas.clientWidth || 600;
    const height = Math.min(width, 520, Math.max(180, (width * (z1 - z0)) / (x1 - x0)));
    canvas.width = width * ratio; canvas.height = height * ratio; canvas.style.height = height + "px";
    const pad = 16, scale = Math.min((width - 2 * pad) / (x1 - x0), (height - 2 * pad) / (z1 - z0));
    const px = (x) => width / 2 + (x - (x0 + x1) / 2) * scale, py = (z) => height / 2 - (z - (z0 + z1) / 2) * scale;
    project = ([x, z]) => [px(x), py(z)];
    follow(shown);
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
      if (!from || !to || Math.hypot(to[0] - from[0], to[1] - from[1]) > 12 || t[i] - t[i - 1] > APART_S) continue;
      pen.strokeStyle = values[i] === null ? css("--faint") : shade((values[i] - low) / (high - low));
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
  dark.addEventListener("change", draw);
  // The heading is as wide as the map, and no taller for what is drawn.
  new ResizeObserver(draw).observe(box.firstChild);
  return { part: box, follow };
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
  if (list.length) rows.push(el("tr", { class: "untold" }, el("td", {}, "not reported"), el("td", { colspan: shown.length }, ...list)));
  return el("table", {}, head, el("tbody", {}, ...rows));
}

if (runs.length > 1) main.append(el("section", { class: "wide" }, el("h2", {}, "Side by side"), table(runs)));
for (const run of runs) {
  const section = el("section", {}, el("h2", {}, run.title));
  if (run.missed.length) section.append(el("ul", { class: "missed" }, ...run.missed.map((words) => el("li", {}, words))));
  const laps = run.card.lap_times_s.map((s) => s.toFixed(1)).join(", "), off = run.how.lap_times_s ?? "";
  // What a run does not tell is its name alone.
  const { part: above, follow } = map(run), { over } = chartsOfRun(run, String(runs.indexOf(run)), follow), { t, speed, steering, cte } = run.drawn;
  const lines = [over("Speed, mph", t, speed, "mph", "--a"),
    over("Steering, degrees", t, steering, "degrees", "--b"),
    over("Offset from the line, m", t, cte, "m", "--good"),
    histogram("Offset from the line, share of the telemetries", cte.filter((value) => value !== null), "m"),
    latency(run, over)];
  const hint = "Point at a chart or use the arrow keys to read it; drag or + to zoom in; double click or Escape for the whole run.";
  const hints = lines.every((line) => typeof line === "string") ? [] : [el("p", { class: "hint readout" }, hint)];
  const parts = [above, ...hints, ...lines];
  const untold = parts.filter((part) => typeof part === "string").join("; ");
  section.append(tiles(run), laps ? el("p", { class: "readout" }, `Lap times: ${laps} s${off}`) : "",
    ...parts.filter((part) => typeof part !== "string"),
    untold ? el("p", { class: "readout" }, `Not reported by this run: ${untold}`) : "", events(run));
  if (runs.length === 1) section.append(el("details", {}, el("summary", {}, "All figures"), table(runs)));
  for (const note of run.card.notes) section.append(el("p", { class: "readout" }, "Note: " + note));
  main.append(section);
}
