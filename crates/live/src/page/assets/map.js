"use strict";
// The track from above, and the car on it.
const TRAIL = 4000;
const chartOf = { course: null, trail: [], place: null };

function showCourse(course) {
  chartOf.course = course;
  chartOf.trail.length = 0;
  say($("course"), course ? course.name : "");
}

function forgetTrail() {
  chartOf.trail.length = 0;
  chartOf.place = null;
}

function addToTrail(place) {
  chartOf.place = place;
  if (!place) return;
  const last = chartOf.trail.at(-1);
  if (last && Math.hypot(last[0] - place.at[0], last[1] - place.at[1]) < 0.5) return;
  chartOf.trail.push(place.at);
  if (chartOf.trail.length > TRAIL) chartOf.trail.splice(0, TRAIL / 4);
}

// The road, the way that was driven, and the car, and those of another run; false where there is nothing to draw.
function drawTrack(canvas, course, trail, place, other = null, colour = "a") {
  const { context, width, height } = sharp(canvas);
  context.clearRect(0, 0, width, height);
  const points = course ? [...course.left, ...course.right] : trail;
  if (points.length < 2) {
    context.fillStyle = colours.faint;
    context.font = "13px system-ui, sans-serif";
    context.textAlign = "center";
    context.fillText("the car's position is not known", width / 2, height / 2);
    return false;
  }
  let [x0, x1, z0, z1] = [Infinity, -Infinity, Infinity, -Infinity];
  for (const [x, z] of points) [x0, x1, z0, z1] = [Math.min(x0, x), Math.max(x1, x), Math.min(z0, z), Math.max(z1, z)];
  const scale = Math.min((width - 24) / Math.max(20, x1 - x0), (height - 24) / Math.max(20, z1 - z0));
  const at = ([x, z]) => [width / 2 + scale * (x - (x0 + x1) / 2), height / 2 - scale * (z - (z0 + z1) / 2)];
  if (course) drawRoad(context, course, at, scale, colours.faint, colours.road);
  // The car of a single trail is of another colour than it, to be seen.
  const car = other ? colour : "b";
  for (const way of [other, { trail, place, colour }]) {
    if (!way) continue;
    drawWay(context, way.trail, at, colours[way.colour]);
    if (way.place) drawCar(context, way.place, at, scale, colours[way === other ? other.colour : car]);
  }
  return true;
}

// A jump is a reset, or an estimate that has changed its mind: no line is drawn along it.
function drawWay(context, trail, at, colour) {
  context.beginPath();
  let before = null;
  for (const point of trail) {
    const near = before && Math.hypot(before[0] - point[0], before[1] - point[1]) <= PUT_M;
    if (near) context.lineTo(...at(point)); else context.moveTo(...at(point));
    before = point;
  }
  context.strokeStyle = colour;
  context.lineWidth = 2;
  context.stroke();
}

function drawCar(context, place, at, scale, colour) {
  const [x, y] = at(place.at);
  if (known(place.off_m)) {
    context.beginPath();
    context.arc(x, y, Math.max(7, scale * 2 * place.off_m), 0, 2 * Math.PI);
    context.fillStyle = colour;
    context.globalAlpha = 0.22;
    context.fill();
    context.globalAlpha = 1;
  }
  context.beginPath();
  context.arc(x, y, 5, 0, 2 * Math.PI);
  context.fillStyle = colour;
  context.fill();
  context.strokeStyle = colours.card;
  context.lineWidth = 2;
  context.stroke();
}

function drawMap() {
  const { course, trail, place } = chartOf;
  const words = !place ? "the car's place on this track is not known yet" : known(place.off_m) ? `estimated from speed and steering, ± ${place.off_m.toFixed(0)} m along the road` : "";
  say($("place"), drawTrack($("map"), course, trail, place) ? words : "");
}
