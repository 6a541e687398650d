"use strict";
// Two runs together: at the same time since their starts, or at the same place along the track.
const NEAR_POINTS = 30, FAR_M = 15;

// How far along the track the car was at each moment: metres from the start line along the middle of the road, adding up over
// laps, and rising the way it drives; null if the road or the place is not known.
function alongOf({ drawn, outline }) {
  if (!outline || outline.left.length < 3 || !drawn.at.some(Boolean)) return null;
  const middle = outline.left.map(([x, z], i) => [(x + outline.right[i][0]) / 2, (z + outline.right[i][1]) / 2]), n = middle.length;
  const apart = ([x, z], [u, v]) => Math.hypot(x - u, z - v), sums = [0];
  for (let i = 1; i <= n; i++) sums.push(sums[i - 1] + apart(middle[i - 1], middle[i % n]));
  const length = sums[n];
  const nearest = (point, from, to) => {
    let best = null;
    for (let i = from; i < to; i++) {
      const k = ((i % n) + n) % n, m = apart(point, middle[k]);
      if (!best || m < best.m) best = { k, m };
    }
    return best;
  };
  let at = null, total = null, last = 0;
  const s = drawn.at.map((point) => {
    if (!point) return null;
    // From where it was: where a road crosses itself, the other one may be as near.
    let found = at === null ? null : nearest(point, at - NEAR_POINTS, at + NEAR_POINTS + 1);
    if (!found || found.m > FAR_M) found = nearest(point, 0, n);
    at = found.k;
    const [x, z] = middle[at], [u, v] = middle[(at + 1) % n], [p, q] = middle[(at + n - 1) % n], long = Math.hypot(u - p, v - q) || 1;
    const here = sums[at] + ((point[0] - x) * (u - p) + (point[1] - z) * (v - q)) / long;
    const by = here - last;
    total = total === null ? here : total + by - length * Math.round(by / length);
    last = here;
    return total;
  });
  const there = s.filter(known), back = there.at(-1) < there[0];
  // Only what lies further than all before: a car that stands or rolls back is nowhere new.
  const way = { s: [], t: [] };
  s.forEach((value, i) => {
    const on = known(value) && (back ? -value : value);
    if (known(value) && (!way.s.length || on > way.s.at(-1) + 1e-3)) { way.s.push(on); way.t.push(drawn.t[i]); }
  });
  return way.s.length > 1 ? { way, back, length } : null;
}

function whyNotByPlace(first, second) {
  if (!first.along || !second.along) return "not aligned by place: it is not known where both cars were";
  if (first.card.track !== second.card.track) return "not aligned by place: they are on different tracks";
  return first.along.back !== second.along.back ? "not aligned by place: they drive in opposite directions" : null;
}

// How the second run goes with the first: its time at the first's, and where in the curves each is drawn.
function together(first, second, by) {
  if (by === "time") return { by, timeOf: (t) => t, xs: [null, null] };
  const [a, b] = [first.along, second.along];
  // One may have begun before the start line and the other behind it: the nearest of its laps.
  const shift = a.length * Math.round((a.way.s[0] - b.way.s[0]) / a.length), shifted = b.way.s.map((s) => s + shift);
  const timeOf = (t) => between(shifted, b.way.t, between(a.way.t, a.way.s, t));
  return { by, timeOf, xs: [a.way, { s: shifted, t: b.way.t }] };
}
