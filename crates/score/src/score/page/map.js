"use strict";
// The road from above, with the driven lines of one run or of several, where drives start, and which way they go.

// Dark blue over green to yellow: read alike by everybody, and in grey.
const SCALE = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];
// How near to a line one has to point, in pixels.
const NEAR_PX = 28;
// Between two arrows on a line, in pixels.
const ARROWS_PX = 110;

function shade(share) {
  const place = Math.min(0.9999, Math.max(0, share)) * (SCALE.length - 1), i = Math.floor(place), part = place - i;
  return `rgb(${SCALE[i].map((value, k) => Math.round(value + part * (SCALE[i + 1][k] - value))).join(",")})`;
}

// A triangle at a place that points along a direction.
function arrow(pen, [x, y], [dx, dy], size, ink) {
  const corners = [[1, 0], [-0.7, 0.75], [-0.35, 0], [-0.7, -0.75]];
  pen.fillStyle = ink; pen.strokeStyle = css("--card"); pen.lineWidth = 1.5;
  pen.beginPath();
  for (const [along, across] of corners) pen.lineTo(x + size * (dx * along - dy * across), y + size * (dy * along + dx * across));
  pen.closePath(); pen.stroke(); pen.fill();
}

// A bar across the road where drives start, an arrow that way, and the word.
function drawStart(pen, { left, right, start }, place) {
  const next = (start + 1) % left.length, [a, b] = [place(left[start]), place(right[start])];
  const [from, to] = [start, next].map((i) => place([(left[i][0] + right[i][0]) / 2, (left[i][1] + right[i][1]) / 2]));
  const length = Math.hypot(to[0] - from[0], to[1] - from[1]) || 1, way = [(to[0] - from[0]) / length, (to[1] - from[1]) / length];
  const across = [b[0] - a[0], b[1] - a[1]], half = Math.hypot(...across) / 2 || 1, out = Math.max(half, 7) / half / 2;
  const middle = [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2];
  const end = (side) => [middle[0] + side * out * across[0], middle[1] + side * out * across[1]];
  pen.strokeStyle = css("--ink"); pen.lineWidth = 3;
  pen.beginPath(); pen.moveTo(...end(-1)); pen.lineTo(...end(1)); pen.stroke();
  arrow(pen, [from[0] + 9 * way[0], from[1] + 9 * way[1]], way, 9, css("--ink"));
  const beside = end(1), away = [across[0] / (2 * half), across[1] / (2 * half)];
  pen.fillStyle = css("--ink"); pen.font = "12px system-ui, sans-serif"; pen.textBaseline = "middle";
  pen.textAlign = away[0] > 0.3 ? "left" : away[0] < -0.3 ? "right" : "center";
  pen.fillText("start", beside[0] + 7 * away[0], beside[1] + 12 * away[1]);
}

// The map of these runs; `point` is told the run and its time that somebody points at. Gives the part of the page and
// `follow`, which shows each car where it was at its time.
function map(shown, point) {
  const several = shown.length > 1, there = shown.filter((run) => run.drawn.at.some((place) => place !== null));
  if (!there.length) return { part: "Map", follow: () => {} };
  const unsure = there.filter((run) => run.drawn.on_line);
  const whose = unsure.length < there.length ? `${unsure.map((run) => run.mark).join(", ")}: ` : "";
  const guessed = unsure.length ? ` (${whose}estimated along the road; the place across it is not known)` : "";
  const box = el("div", { class: "above" }, el("h3", {}, "Map" + guessed));
  const canvas = el("canvas"), bar = el("i"), least = el("span"), most = el("span");
  const cars = there.map(({ mark, colour }) => el("i", { class: "car", hidden: "", ...(several && { style: `background: ${colour}`, title: mark }) }));
  box.append(el("div", { class: "map" }, canvas, ...cars));
  if (!several) box.append(el("div", { class: "legend" }, least, bar, most));
  const outline = there.find((run) => run.outline)?.outline;
  const all = [...there.flatMap((run) => run.drawn.at.filter((place) => place)), ...(outline ? [...outline.left, ...outline.right] : [])];
  const [x0, x1] = extent(all.map((p) => p[0])), [z0, z1] = extent(all.map((p) => p[1]));
  let times = there.map(() => null), project = () => [0, 0];
  const follow = (at) => {
    times = there.map((run) => at(run));
    there.forEach(({ drawn: { at, t } }, i) => {
      const place = times[i] === null ? null : at[before(t, times[i])];
      cars[i].hidden = !place;
      if (place) [cars[i].style.left, cars[i].style.top] = project(place).map((px) => px + "px");
    });
  };
  function drawLine(pen, { drawn: { at, t, speed, cte }, colour: ink }) {
    const offset = by.value === "cte" && cte.some((value) => value !== null);
    const values = offset ? cte.map((value) => (value === null ? null : Math.abs(value))) : speed;
    const [low, high] = extent(values, 0);
    let since = ARROWS_PX / 2;
    const arrows = [];
    pen.lineWidth = several ? 2 : 2.5; pen.lineCap = "round";
    for (let i = 1; i < at.length; i++) {
      const [from, to] = [at[i - 1], at[i]];
      if (!from || !to || Math.hypot(to[0] - from[0], to[1] - from[1]) > PUT_M || t[i] - t[i - 1] > APART_S) continue;
      const [a, b] = [project(from), project(to)], length = Math.hypot(b[0] - a[0], b[1] - a[1]);
      pen.strokeStyle = several ? ink : values[i] === null ? css("--faint") : shade((values[i] - low) / (high - low));
      pen.beginPath(); pen.moveTo(...a); pen.lineTo(...b); pen.stroke();
      since += length;
      if (length > 0 && since > ARROWS_PX) { since = 0; arrows.push([b, [(b[0] - a[0]) / length, (b[1] - a[1]) / length]]); }
    }
    for (const [place, way] of arrows) arrow(pen, place, way, 6, several ? ink : css("--ink"));
    bar.style.background = `linear-gradient(90deg, ${SCALE.map((c) => `rgb(${c})`).join(",")})`;
    const unit = offset ? "m off the line" : "mph";
    least.textContent = low.toFixed(offset ? 2 : 1); most.textContent = `${high.toFixed(offset ? 2 : 1)} ${unit}`;
  }
  const draw = () => {
    const ratio = devicePixelRatio || 1, width = canvas.clientWidth || 600;
    const height = Math.min(width, 520, Math.max(180, (width * (z1 - z0)) / (x1 - x0)));
    canvas.width = width * ratio; canvas.height = height * ratio; canvas.style.height = height + "px";
    const pad = 22, scale = Math.min((width - 2 * pad) / (x1 - x0), (height - 2 * pad) / (z1 - z0));
    project = ([x, z]) => [width / 2 + (x - (x0 + x1) / 2) * scale, height / 2 - (z - (z0 + z1) / 2) * scale];
    const pen = canvas.getContext("2d");
    pen.scale(ratio, ratio);
    if (outline) drawRoad(pen, outline, project, scale, css("--line"), css("--road"));
    for (const run of there) drawLine(pen, run);
    for (const { drawn: { at, t, events } } of there) for (const event of events) {
      if (!["collision", "off-road", "stuck", "takeover-began", "bad-frame", "note"].includes(event.kind)) continue;
      const place = at[before(t, event.t)];
      if (!place) continue;
      pen.fillStyle = css("--bad"); pen.strokeStyle = css("--card"); pen.lineWidth = 2;
      pen.beginPath(); pen.arc(...project(place), 5, 0, 7); pen.fill(); pen.stroke();
    }
    if (outline) drawStart(pen, outline, project);
    const now = times;
    follow((run) => now[there.indexOf(run)] ?? null);
  };
  canvas.addEventListener("pointermove", (event) => {
    const { left, top } = canvas.getBoundingClientRect(), [x, y] = [event.clientX - left, event.clientY - top];
    let nearest = null, near = NEAR_PX;
    for (const run of there) run.drawn.at.forEach((place, i) => {
      if (!place) return;
      const [px, py] = project(place), away = Math.hypot(px - x, py - y);
      if (away < near) { near = away; nearest = [run, run.drawn.t[i]]; }
    });
    if (nearest) point(...nearest);
  });
  redraws.push(draw);
  // The heading is as wide as the map, and no taller for what is drawn.
  new ResizeObserver(draw).observe(box.firstChild);
  return { part: box, follow };
}
