"use strict";
// The curves of the player: speed, steering and offset of one run or of two, and the steering of another model.
const runCharts = [];
const RUN_CURVES = [
  { title: "Speed, mph", range: fromZero, of: ({ drawn }) => ({ t: drawn.t, y: drawn.speed }) },
  { title: "Steering command, degrees", range: bothWays, model: true, of: ({ drawn, command }) => (command.t.length ? { t: command.t, y: command.steering.map((share) => share * FULL_LOCK_DEG) } : { t: drawn.t, y: drawn.steering }) },
  { title: "Offset from the line, m", range: offsets, of: ({ drawn }) => ({ t: drawn.t, y: drawn.cte }) },
];

function offsets(_, low, high) {
  const most = Math.max(1, Math.ceil(Math.max(Math.abs(low ?? 0), Math.abs(high ?? 0))));
  return [-most, most];
}

// A series over the axis that both runs share: time, or metres along the track.
function onAxis({ t, y }, way) {
  if (!way) return [t, y];
  const x = [], values = [];
  t.forEach((time, i) => {
    const s = between(way.t, way.s, time);
    if (!x.length || s > x.at(-1) + 1e-3) { x.push(s); values.push(y[i]); }
  });
  return [x, values];
}

// Where the cursor of all curves is.
const axisAt = (tick) => (player.together?.xs[0] ? between(player.together.xs[0].t, player.together.xs[0].s, tick) : tick);

function tickAtAxis(x) {
  const way = player.together?.xs[0];
  return before(player.ticks, way ? between(way.s, way.t, x) : x);
}

function linesOf({ model, of }) {
  const { first, second, together } = player, xs = together?.xs ?? [null, null];
  const lines = [[first, "run 1", "b", xs[0]], [second, "run 2", "a", xs[1]]].filter(([run]) => run).map(([run, name, colour, way]) => ({ name: second ? name : model ? "recorded" : "", colour, width: 1.5, data: onAxis(of(run), way) }));
  if (model && compared.t.length) {
    lines.push({ name: compared.name, colour: "c", width: 1.3, data: onAxis({ t: compared.t, y: compared.steering.map((share) => (known(share) ? share * FULL_LOCK_DEG : null)) }, xs[0]) });
  }
  return lines.filter(({ data: [, y] }) => y.some(known));
}

function runCurves() {
  for (const chart of runCharts.splice(0)) chart.plot.destroy();
  $("run-curves").replaceChildren();
  if (!player.first) return;
  const byPlace = Boolean(player.together?.xs[0]);
  const axis = { stroke: () => colours.faint, font: "11px system-ui, sans-serif", ticks: { show: false }, gap: 4 };
  const now = (u) => {
    const x = u.valToPos(axisAt(player.ticks[player.index] ?? 0), "x", true), { top, height } = u.bbox;
    u.ctx.fillStyle = colours.ink;
    u.ctx.fillRect(x - 1, top, 2, height);
  };
  for (const spec of RUN_CURVES) {
    const lines = linesOf(spec);
    if (!lines.length) continue;
    const box = el("div", { class: "chart", role: "img", "aria-label": spec.title });
    const keys = lines.filter(({ name }) => name).map(({ name, colour }) => {
      const key = el("i");
      key.style.background = `var(--${colour})`;
      return el("span", {}, key, name);
    });
    $("run-curves").append(el("p", { class: "legend" }, el("strong", {}, spec.title), ...keys), box);
    const plot = new uPlot({
      width: 600, height: 110, padding: [6, 18, 0, 0], legend: { show: false }, cursor: { drag: { x: false, y: false }, y: false },
      scales: { x: { time: false }, y: { range: spec.range } },
      axes: [{ ...axis, size: 18, space: 70, grid: { show: false }, values: (_, splits) => splits.map((x) => (byPlace ? `${x} m` : clock(x).replace(/\.0$/, ""))) }, { ...axis, size: 36, space: 26, grid: { stroke: () => colours.line, width: 1 } }],
      series: [{}, ...lines.map(({ colour, width }) => ({ stroke: () => colours[colour], width, points: { show: false } }))], hooks: { draw: [now] },
    }, uPlot.join(lines.map(({ data }) => data)), box);
    plot.over.addEventListener("click", ({ clientX }) => { play(false); seek(tickAtAxis(plot.posToVal(clientX - plot.over.getBoundingClientRect().left, "x"))); });
    new ResizeObserver(([{ contentRect }]) => contentRect.width && plot.setSize({ width: contentRect.width, height: 110 })).observe(box);
    runCharts.push({ plot, spec, count: lines.length });
  }
  if (byPlace) $("run-curves").append(el("p", { class: "readout" }, "along the track, in metres from the start line"));
}

// More of a model's steering has come: only that chart's data changes.
function growCurves() {
  const chart = runCharts.find(({ spec }) => spec.model), lines = chart && linesOf(chart.spec);
  if (!chart || lines.length !== chart.count) return runCurves();
  chart.plot.setData(uPlot.join(lines.map(({ data }) => data)));
}

const drawCursor = () => runCharts.forEach(({ plot }) => plot.redraw(false, false));
dark.addEventListener("change", () => runCharts.forEach(({ plot }) => plot.redraw(false)));
