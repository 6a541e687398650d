"use strict";
// The figures of runs: the few that sum a run up, and all of them.
const DECIMALS = { "": 0, "%": 1, m: 2, s: 1, mph: 2, lock: 4, lock2: 5 };
const TILES = [
  "completion", "collisions", "off_roads", "autonomy", "driving_score", "mean_cte_m", "p95_cte_m", "max_cte_m", "mean_mph", "steering_rate_deg_s",
];

function show(figure, value) {
  if (value === null || value === undefined) return "–";
  if (figure.unit === "%") return (100 * value).toFixed(1) + " %";
  const digits = DECIMALS[figure.unit] ?? 2;
  const whole = Number.isInteger(value) && figure.unit === "";
  return (whole ? String(value) : value.toFixed(figure.unit === "" ? 2 : digits)) + (figure.unit ? " " + figure.unit : "");
}

// A run's figure in words, and where it comes from.
function told({ card, how }, { key, ...figure }) {
  const why = card.not_measurable[key];
  const words = (card.estimates[key] ? "≈ " : "") + show(figure, card[key]);
  return { words, value: card[key] ?? "", title: why ? `Not measurable: ${why}.` : (how[key] ?? "").trim() };
}

// A run's letter in its colour.
const chip = ({ mark, colour, title }) => el("b", { class: "chip", style: `--of: ${colour}`, title }, mark);

function tiles(run) {
  return el("div", { class: "tiles" }, ...TILES.map((key) => {
    const figure = figures.find((one) => one.key === key), { words, title } = told(run, figure);
    return el("div", { class: "tile", title: `${figure.meaning}\n${title}`.trim() }, el("b", {}, words), el("span", {}, figure.label));
  }));
}

// A line for each run with what sums it up; sorted by a click on a head.
function summary(shown) {
  const known = TILES.map((key) => figures.find((one) => one.key === key));
  const first = ({ better }) => (better === "higher" ? "descending" : "ascending");
  const head = el("tr", {}, el("th", { scope: "col" }, "run"), ...known.map((figure) => el("th", { scope: "col", title: figure.meaning, "data-first": first(figure) }, figure.label)));
  const rows = shown.map((run) => el("tr", {},
    el("th", { scope: "row" }, chip(run), el("a", { href: `#run-${run.mark}` }, run.title)),
    ...known.map((figure) => {
      const { words, value, title } = told(run, figure);
      return el("td", { "data-value": value, "data-label": figure.label, title }, words);
    })));
  return sortable(el("table", { class: "summary" }, el("thead", {}, head), el("tbody", {}, ...rows)));
}

// Every figure of runs; those that are zero everywhere, and those that no run reports, are folded away.
function table(shown) {
  const several = shown.length > 1;
  // On different tracks none is the best.
  const comparable = new Set(shown.map((run) => JSON.stringify([run.card.track, run.card.scenario]))).size === 1;
  const values = (figure) => shown.map((run) => run.card[figure.key]);
  const [untold, reported] = [(figure) => values(figure).every((value) => value === null), (figure) => !untold(figure)];
  const zero = (figure) => reported(figure) && values(figure).every((value) => value === 0);
  const row = (figure) => {
    const known = values(figure).filter((value) => value !== null);
    const best = figure.better === "higher" ? Math.max(...known) : figure.better === "lower" ? Math.min(...known) : NaN;
    const differ = comparable && new Set(known).size > 1;
    const cells = shown.map((run) => {
      const { words, value, title } = told(run, figure);
      return el("td", { class: value === "" ? "none" : differ && value === best ? "best" : "", title, ...(several && { "data-label": run.mark }) }, words);
    });
    return el("tr", {}, el("th", { scope: "row", title: figure.meaning }, figure.label), ...cells);
  };
  const head = several ? el("thead", {}, el("tr", {}, el("th", {}), ...shown.map((run) => el("th", { scope: "col" }, chip(run))))) : "";
  const rows = figures.filter((figure) => reported(figure) && !zero(figure)).map(row);
  const folded = (words, which, why) => {
    const names = figures.filter(which).map((figure) => el("span", { title: `${figure.meaning}\n${why(figure)}`.trim() }, figure.label));
    const list = names.flatMap((one, i) => (i ? [", ", one] : [one]));
    return names.length ? el("details", { class: "folded" }, el("summary", {}, `${words}: ${names.length}`), el("p", {}, ...list)) : "";
  };
  return el("div", {}, el("table", { class: "figures" }, head, el("tbody", {}, ...rows)),
    folded("Figures that are zero", zero, () => ""),
    folded("Figures that are not reported", untold, ({ key }) => `Not measurable: ${shown[0].card.not_measurable[key]}.`));
}

// Latency by stage.
function stages(run) {
  const rows = Object.entries(run.card.latency_ms).map(([stage, q]) =>
    el("tr", {}, el("td", {}, stage), ...[q.p50, q.p95, q.p99].map((v) => el("td", {}, v.toFixed(2)))));
  const head = el("thead", {}, el("tr", {}, ...["stage", "p50 ms", "p95 ms", "p99 ms"].map((name) => el("th", {}, name))));
  return el("table", { class: "stages" }, head, el("tbody", {}, ...rows));
}
