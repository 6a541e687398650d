"use strict";
// Draws the page from the data in it: for people in a hurry first. Everything a run says may be missing: null is "not
// measurable".
const { runs, figures } = JSON.parse(document.getElementById("data").textContent);
const main = document.getElementById("main"), by = document.getElementById("by"), across = document.getElementById("across");
// Maps, for when the colours change.
let redraws = [];
for (const source of [by, dark]) source.addEventListener("change", () => redraws.forEach((draw) => draw()));

// Letters and colours of runs: told apart by everybody, in light and dark; after eight the colours come again.
const COLOURS = ["#0a84c6", "#d9622b", "#2a9d5c", "#a05ccf", "#c9a000", "#d6457b", "#00a3a3", "#8a6d4b"];
const letter = (i) => (i < 26 ? "" : letter(Math.floor(i / 26) - 1)) + String.fromCharCode(65 + (i % 26));
const MPS_PER_MPH = 0.44704;
runs.forEach((run, i) => {
  const { t, speed } = run.drawn;
  let metres = 0;
  // How far the car had come, in metres.
  run.metres = t.map((now, k) => (metres += k && now - t[k - 1] <= APART_S ? Math.abs(speed[k]) * MPS_PER_MPH * (now - t[k - 1]) : 0));
  Object.assign(run, { mark: letter(i), colour: COLOURS[i % COLOURS.length] });
});

// What curves are drawn over: where a time of a run lies, and the time there.
const AXES = {
  time: {
    words: clock, ticks: { incrs: CLOCK_S, values: (_, splits) => splits.map((t) => clock(t).replace(/\.0$/, "")) },
    of: () => ({ x: (t) => t, t: (x) => x }),
  },
  distance: {
    words: (x) => `${x.toFixed(0)} m`, ticks: { values: (_, splits) => splits.map((x) => `${number(x)} m`) },
    of: ({ metres, drawn: { t } }) => ({ x: (time) => between(t, metres, time), t: (x) => between(metres, t, x) }),
  },
};

function events(run, point) {
  const box = el("div", {}, el("h3", {}, "Events"));
  if (!run.drawn.events.length) return box.append(el("p", { class: "readout" }, "none")), box;
  for (const { t, words, pictures } of run.drawn.events) {
    const frames = [...pictures].sort((a, b) => a[0] - b[0]).map(([from, jpeg]) => {
      const figure = el("figure", {},
        el("img", { src: "data:image/jpeg;base64," + jpeg, alt: "the camera's picture", loading: "lazy" }),
        el("figcaption", {}, `${from >= 0 ? "+" : "−"}${Math.abs(from).toFixed(1)} s`));
      figure.addEventListener("pointerenter", () => point(run, t + from));
      return figure;
    });
    const time = el("button", { type: "button", class: "time", title: "show this moment in the curves and on the map" }, clock(t));
    time.addEventListener("click", () => point(run, t));
    box.append(el("div", { class: "event" }, time, words, el("div", { class: "frames" }, ...frames)));
  }
  return box;
}

// What each camera saw at its time; `follow` as the map has it.
function cameras(shown) {
  const seen = shown.filter((run) => run.drawn.frames?.length);
  if (!seen.length) return { part: "", follow: () => {} };
  const figures = seen.map((run) => {
    const image = el("img", { alt: "what the camera saw" }), words = el("span");
    return { run, image, words, part: el("figure", {}, image, el("figcaption", {}, shown.length > 1 ? chip(run) : "", words)) };
  });
  const follow = (at) => figures.forEach(({ run, image, words }) => {
    const { frames } = run.drawn, times = frames.map(([t]) => t), wanted = at(run) ?? 0, i = before(times, wanted);
    const near = i + 1 < times.length && times[i + 1] - wanted < wanted - times[i] ? i + 1 : i;
    const source = "data:image/jpeg;base64," + frames[near][1];
    if (image.src !== source) image.src = source;
    words.textContent = clock(times[near]);
  });
  follow(() => null);
  return { part: el("div", { class: "cameras" }, el("h3", {}, "Camera"), ...figures.map(({ part }) => part)), follow };
}

// Map, cameras and curves of runs, under one cursor.
function together(shown, key) {
  const axis = AXES[across.value], lines = shown.map((run) => Object.assign(run, axis.of(run)));
  let charts = null;
  const point = (run, t) => charts.show(run.x(t));
  const { part: above, follow: drive } = map(lines, point), { part: camera, follow: look } = cameras(lines);
  const follow = (x) => {
    // A run that is over is nowhere.
    const at = (run) => (x === null || x > run.x(run.drawn.t.at(-1) ?? 0) + LEAST ? null : run.t(x));
    drive(at); look(at);
  };
  charts = chartsOf(lines, axis, key, follow);
  const { over, strip, unzoom } = charts;
  const curves = [
    ...lines.map((run) => strip(run, shown.length > 1 ? `Pictures of ${run.mark}` : "Pictures")),
    over("Speed, mph", "mph", "--a", ({ drawn: { t, speed } }) => ({ ts: t, ys: speed })),
    over("Steering, degrees", "degrees", "--b", ({ drawn: { t, steering } }) => ({ ts: t, ys: steering })),
    over("Offset from the line, m", "m", "--good", ({ drawn: { t, cte } }) => ({ ts: t, ys: cte })),
  ];
  return { above, camera, curves, over, point, unzoom };
}

// The parts of a section; those that are a title alone are things that nobody reports.
function put(section, { above, camera, unzoom }, curves, ...more) {
  const parts = [above, ...curves], there = (part) => typeof part !== "string", untold = parts.filter((part) => !there(part));
  const charts = curves.filter(there);
  if (there(above) || there(camera)) section.append(el("div", { class: "look" }, there(above) ? above : "", camera));
  if (charts.length) {
    const whole = el("button", { type: "button", class: "whole" }, "Whole run");
    whole.addEventListener("click", unzoom);
    const words = "Point at a curve, the map or a picture, or use the arrow keys. Drag or press + to zoom in; double-click, press Escape or click the button to see the whole run.";
    section.append(el("p", { class: "hint readout" }, words, " ", whole));
  }
  section.append(...charts, untold.length ? el("p", { class: "readout" }, `Not reported: ${untold.join("; ")}`) : "", ...more);
}

function ofOne(run) {
  const section = el("section", { id: `run-${run.mark}` }, el("h2", {}, ...(runs.length > 1 ? [chip(run)] : []), run.title));
  if (run.missed.length) section.append(el("ul", { class: "missed" }, ...run.missed.map((words) => el("li", {}, words))));
  const laps = run.card.lap_times_s.map((s) => s.toFixed(1)).join(", "), off = run.how.lap_times_s ?? "";
  section.append(tiles(run), laps ? el("p", { class: "readout" }, `Lap times: ${laps} s${off}`) : "");
  const shown = together([run], run.mark), { cte, answers } = run.drawn;
  const latency = shown.over("Time to answer, ms (the slowest of each few answers)", "ms", "--b", () => ({ ts: answers.map(([t]) => t), ys: answers.map(([, ms]) => ms) }));
  if (typeof latency !== "string") latency.append(stages(run));
  const spread = histogram("Offset from the line, share of the telemetries", cte.filter((value) => value !== null), "m");
  put(section, shown, [...shown.curves, latency, spread], events(run, shown.point));
  if (runs.length === 1) section.append(el("details", { open: "" }, el("summary", {}, "All figures"), table(runs)));
  for (const note of run.card.notes) section.append(el("p", { class: "readout" }, "Note: " + note));
  return section;
}

// Runs of one road, laid over one another.
function overlays() {
  const roads = new Map();
  for (const run of runs) if (run.card.track) roads.set(run.card.track, [...(roads.get(run.card.track) ?? []), run]);
  return [...roads].filter(([, shown]) => shown.length > 1).map(([track, shown]) => {
    const section = el("section", { class: "wide" }, el("h2", {}, `${track}: ${shown.length} runs laid over one another`));
    const key = el("p", { class: "key" }, ...shown.flatMap((run) => [chip(run), run.title, " "]));
    section.append(key);
    const all = together(shown, `all ${track}`);
    put(section, all, all.curves);
    return section;
  });
}

function build() {
  drawn.clear();
  redraws = [];
  main.replaceChildren();
  if (runs.length > 1) {
    main.append(el("section", { class: "wide" }, el("h2", {}, "Summary"), summary(runs)), ...overlays());
  }
  main.append(...runs.map(ofOne));
  if (runs.length > 1) main.append(el("section", { class: "wide" }, el("h2", {}, "All figures, side by side"), table(runs)));
}

across.addEventListener("change", build);
build();
