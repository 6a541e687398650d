"use strict";
// Recorded runs: a list with pictures and scores, and a player.
const runs = { open: null, index: 0, playing: null, fetching: false, wanted: null, bitmap: null, charts: [], listed: "" };
const GLANCE = ["completion", "collisions", "off the road", "autonomy", "distance", "speed"];

const secret = () => (token ? `?token=${encodeURIComponent(token)}` : "");
const pathOf = (name, rest = "") => `api/runs/${encodeURIComponent(name)}${rest}`;
async function getRuns(path) {
  const response = await fetch(path, { headers: token ? { Authorization: `Bearer ${token}` } : {} });
  if (!response.ok) throw new Error((await response.json().catch(() => null))?.error ?? `refused: ${response.status}`);
  return response;
}

function showView(which) {
  const past = which === "runs";
  $("main").hidden = past;
  $("tabs").hidden = past;
  $("runs").hidden = !past;
  $("to-live").setAttribute("aria-pressed", !past);
  $("to-runs").setAttribute("aria-pressed", past);
  takeWheel(false);
  play(false);
  if (past) listRuns(); else draw();
}
$("to-live").addEventListener("click", () => showView("live"));
$("to-runs").addEventListener("click", () => showView("runs"));

async function listRuns() {
  let listed;
  try {
    listed = await (await getRuns("api/runs")).json();
    say($("runs-answer"), listed.length ? "" : "No run is in the folder yet.");
  } catch (error) {
    say($("runs-answer"), error.message);
    return;
  }
  const key = JSON.stringify(listed);
  if (key === runs.listed) return;
  runs.listed = key;
  const rows = listed.map(({ name, bytes, modified_s }) => {
    const when = new Date(1000 * modified_s).toLocaleString(), words = el("span", { class: "readout" }, "…"), image = el("img", { alt: "", width: 120, height: 60 });
    const button = el("button", { "data-name": name }, image, el("span", {}, el("strong", {}, name.replace(/\.mcap$/, "")), el("small", {}, `${when} · ${(bytes / 2 ** 20).toFixed(1)} MiB`), words));
    button.addEventListener("click", () => openRun(name));
    return { name, words, image, node: el("li", {}, button) };
  });
  $("run-list").replaceChildren(...rows.map(({ node }) => node));
  // One after the other: each is read from its beginning to its end.
  for (const { name, words, image } of rows) {
    if (runs.listed !== key || $("runs").hidden) { runs.listed = ""; return; }
    try {
      const glance = await (await getRuns(pathOf(name, "/glance"))).json();
      say(words, glance.rows.filter(([row]) => GLANCE.includes(row)).map(([row, value]) => `${row} ${value}`).join(" · "));
      const picture = await fetch(pathOf(name, "/glance/picture"), { headers: token ? { Authorization: `Bearer ${token}` } : {} });
      if (picture.ok) image.src = URL.createObjectURL(await picture.blob());
      image.onload = () => URL.revokeObjectURL(image.src);
    } catch (error) {
      say(words, error.message);
    }
  }
}

async function openRun(name) {
  play(false);
  say($("runs-answer"), `reading ${name} …`);
  try {
    runs.open = await (await getRuns(pathOf(name))).json();
    say($("runs-answer"), "");
  } catch (error) {
    say($("runs-answer"), error.message);
    return;
  }
  const { title, rows, drawn, outline, frames_s } = runs.open;
  $("player").hidden = false;
  say($("run-title"), title);
  for (const node of $("run-list").querySelectorAll("button")) node.setAttribute("aria-current", node.dataset.name === name);
  $("run-file").href = pathOf(name, "/file") + secret();
  $("run-report").href = pathOf(name, "/report") + secret();
  const end = frames_s.at(-1) ?? 0, time = $("time");
  Object.assign(time, { min: 0, max: Math.max(0, frames_s.length - 1), value: 0 });
  time.disabled = frames_s.length < 2;
  const marks = drawn.events.filter(({ kind }) => kind !== "run-ended");
  $("marks").replaceChildren(...marks.map(({ t, kind, words }) => {
    const mark = el("i", { "data-kind": kind, title: `${clock(t)} ${words}` });
    mark.style.left = `${end > 0 ? Math.min(100, (100 * t) / end) : 0}%`;
    return mark;
  }));
  $("run-events").replaceChildren(...(drawn.events.length ? drawn.events.map(({ t, kind, words }) => {
    const button = el("button", { "data-kind": kind }, el("time", {}, clock(t)), words);
    button.addEventListener("click", () => seek(frameAt(t)));
    return el("li", {}, button);
  }) : [el("li", { class: "none" }, "nothing happened")]));
  $("run-score").replaceChildren(...rows.flatMap(([row, words]) => [el("dt", {}, row), el("dd", {}, words)]));
  runCurves(drawn);
  runs.outline = outline;
  seek(0);
  $("player").scrollIntoView({ block: "start" });
}

// Index of the last number that is not after t.
function before(times, t) {
  let low = 0, high = times.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (times[middle] <= t + 1e-6) low = middle; else high = middle - 1;
  }
  return low;
}
const frameAt = (t) => before(runs.open.frames_s, t);

function runCurves({ t, speed, steering }) {
  for (const chart of runs.charts) chart.destroy();
  $("run-curves").replaceChildren();
  const axis = { stroke: () => colours.faint, font: "11px system-ui, sans-serif", ticks: { show: false }, gap: 4 };
  const now = (u) => {
    const x = u.valToPos(runs.open.frames_s[runs.index] ?? 0, "x", true), { top, height } = u.bbox;
    u.ctx.fillStyle = colours.b;
    u.ctx.fillRect(x - 1, top, 2, height);
  };
  runs.charts = [["Speed, mph", speed, "a", fromZero], ["Steering, degrees", steering, "b", bothWays]].map(([title, values, colour, range]) => {
    const box = el("div", { class: "chart", role: "img", "aria-label": title });
    $("run-curves").append(el("p", { class: "legend" }, el("strong", {}, title)), box);
    const chart = new uPlot({
      width: 600, height: 100, padding: [6, 18, 0, 0], legend: { show: false }, cursor: { drag: { x: false, y: false }, y: false },
      scales: { x: { time: false }, y: { range } },
      axes: [{ ...axis, size: 18, space: 70, grid: { show: false }, values: (_, splits) => splits.map((s) => clock(s).replace(/\.0$/, "")) }, { ...axis, size: 36, space: 26, grid: { stroke: () => colours.line, width: 1 } }],
      series: [{}, { stroke: () => colours[colour], width: 1.4, points: { show: false } }], hooks: { draw: [now] },
    }, [t, values], box);
    chart.over.addEventListener("click", ({ clientX }) => seek(frameAt(chart.posToVal(clientX - chart.over.getBoundingClientRect().left, "x"))));
    new ResizeObserver(([{ contentRect }]) => contentRect.width && chart.setSize({ width: contentRect.width, height: 100 })).observe(box);
    return chart;
  });
}
dark.addEventListener("change", () => runs.charts.forEach((chart) => chart.redraw(false)));

function seek(index) {
  if (!runs.open) return;
  runs.index = Math.min(Math.max(0, index), Math.max(0, runs.open.frames_s.length - 1));
  $("time").value = runs.index;
  const t = runs.open.frames_s[runs.index] ?? 0, { drawn } = runs.open, i = before(drawn.t, t);
  const facts = [`${clock(t)}`, `frame ${runs.index + 1} of ${runs.open.frames_s.length}`, known(drawn.speed[i]) ? `${drawn.speed[i].toFixed(1)} mph` : "", known(drawn.steering[i]) ? `${drawn.steering[i].toFixed(1)}°` : "", known(drawn.cte[i]) ? `${Math.abs(drawn.cte[i]).toFixed(2)} m off the line` : ""];
  say($("run-facts"), facts.filter(Boolean).join(" · "));
  $("time").setAttribute("aria-valuetext", facts.filter(Boolean).join(", "));
  runs.charts.forEach((chart) => chart.redraw(false, false));
  drawRunMap(i);
  fetchFrame();
}

// The newest picture that is wanted, one at a time.
async function fetchFrame() {
  runs.wanted = runs.index;
  if (runs.fetching || !runs.open.frames_s.length) return;
  runs.fetching = true;
  while (runs.wanted !== null) {
    const { name } = runs.open, n = runs.wanted;
    runs.wanted = null;
    try {
      const bitmap = await createImageBitmap(await (await getRuns(pathOf(name, `/frames/${n}`))).blob());
      runs.bitmap?.close();
      runs.bitmap = bitmap;
      const { context, width, height } = sharp($("frame"));
      context.drawImage(bitmap, 0, 0, width, height);
      const { drawn, frames_s } = runs.open, steering = drawn.steering[before(drawn.t, frames_s[n])];
      if (known(steering)) drawPath(context, width, height, steering / FULL_LOCK_DEG, "#ff7a45", 3);
      $("frame").dataset.shown = n;
    } catch (error) {
      say($("runs-answer"), error.message);
    }
  }
  runs.fetching = false;
}

function drawRunMap(i) {
  const { drawn } = runs.open, at = drawn.at[i] ?? null, trail = drawn.at.slice(0, i + 1).filter(Boolean);
  drawTrack($("run-map"), runs.outline, trail, at && { at });
}

function play(on) {
  if (on === Boolean(runs.playing)) return;
  say($("play"), on ? "Pause" : "Play");
  $("play").setAttribute("aria-pressed", on);
  cancelAnimationFrame(runs.playing?.frame);
  runs.playing = null;
  if (!on || !runs.open) return;
  if (runs.index >= runs.open.frames_s.length - 1) seek(0);
  runs.playing = { from: performance.now(), at: runs.open.frames_s[runs.index] ?? 0 };
  const step = (now) => {
    if (!runs.playing) return;
    const index = frameAt(runs.playing.at + (now - runs.playing.from) / 1000);
    if (index !== runs.index) seek(index);
    if (index >= runs.open.frames_s.length - 1) return play(false);
    runs.playing.frame = requestAnimationFrame(step);
  };
  runs.playing.frame = requestAnimationFrame(step);
}
$("play").addEventListener("click", () => play(!runs.playing));
const step = (by) => { play(false); seek(runs.index + by); };
$("back").addEventListener("click", () => step(-1));
$("forth").addEventListener("click", () => step(1));
$("time").addEventListener("input", () => { play(false); seek(+$("time").value); });
