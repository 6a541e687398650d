"use strict";
// The last minute as curves, by uPlot.
const MINUTE_S = 60;
// Beyond this many seconds between two moments the line is broken.
const BREAK_S = 2;

const minute = { t: [], speed: [], set: [], steering: [], asked: [], throttle: [], last: null };
const SERIES = ["t", "speed", "set", "steering", "asked", "throttle"];

function forgetMinute() {
  for (const name of SERIES) minute[name].length = 0;
  minute.last = null;
}

function addToMinute(turn, status) {
  const { t } = turn;
  if (known(minute.last) && t < minute.last) forgetMinute(); // another run
  if (known(minute.last) && t === minute.last) return;
  const add = (values) => SERIES.forEach((name, i) => minute[name].push(values[i] ?? null));
  if (known(minute.last) && t - minute.last > BREAK_S) add([minute.last + 0.001]);
  add([t, turn.speed_mph, status?.set_speed_mph, turn.steering_deg, turn.command ? turn.command[0] * FULL_LOCK_DEG : null, turn.command?.[1] ?? turn.throttle]);
  minute.last = t;
  let old = 0;
  while (minute.t[old] < t - MINUTE_S) old++;
  if (old > 200) for (const name of SERIES) minute[name].splice(0, old); // now and then: a splice moves the rest
}

// Ranges of axes that end where a line of the grid is.
const fromZero = (_, low, high) => [0, Math.max(10, Math.ceil((1.1 * (high ?? 0)) / 10) * 10)];
function bothWays(_, low, high) {
  const most = Math.max(5, Math.ceil(Math.max(Math.abs(low ?? 0), Math.abs(high ?? 0)) / 5) * 5);
  return [-most, most];
}

function curve(title, lines, range) {
  const legend = el("p", { class: "legend" }, el("strong", {}, title), ...lines.map(({ name, colour }) => {
    const key = el("i", { "data-colour": colour });
    key.style.background = `var(--${colour})`;
    return el("span", {}, key, name);
  }));
  const box = el("div", { class: "chart", role: "img", "aria-label": `${title} over the last minute` });
  $("curves").append(legend, box);
  const axis = { stroke: () => colours.faint, font: "11px system-ui, sans-serif", ticks: { show: false }, gap: 4 };
  const chart = new uPlot({
    width: 600, height: 92, padding: [6, 14, 0, 0], legend: { show: false }, cursor: { show: false },
    scales: { x: { time: false, range: () => [(minute.last ?? MINUTE_S) - MINUTE_S, minute.last ?? MINUTE_S] }, y: { range } },
    axes: [{ ...axis, size: 18, space: 70, grid: { show: false }, values: (_, splits) => splits.map((t) => (t < 0 ? "" : clock(t).replace(/\.0$/, ""))) },
      { ...axis, size: 36, space: 22, grid: { stroke: () => colours.line, width: 1 } }],
    series: [{}, ...lines.map(({ colour, width, dash }) => ({ stroke: () => colours[colour], width, dash, points: { show: false }, spanGaps: false, pxAlign: 0 }))],
  }, [[], ...lines.map(() => [])], box);
  new ResizeObserver(([{ contentRect }]) => contentRect.width && chart.setSize({ width: contentRect.width, height: 92 })).observe(box);
  dark.addEventListener("change", () => chart.redraw(false));
  return () => chart.setData([minute.t, ...lines.map(({ data }) => minute[data])]);
}

const drawCurves = [
  curve("Speed, mph", [{ name: "set", data: "set", colour: "b", width: 1.2, dash: [5, 4] }, { name: "speed", data: "speed", colour: "a", width: 1.8 }],
    fromZero),
  curve("Steering, degrees", [{ name: "reported", data: "steering", colour: "faint", width: 1.2 }, { name: "commanded", data: "asked", colour: "b", width: 1.6 }],
    bothWays),
  curve("Throttle and brake", [{ name: "throttle", data: "throttle", colour: "good", width: 1.6 }], () => [-1.05, 1.05]),
];
