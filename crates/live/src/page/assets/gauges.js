"use strict";
// The camera's picture with the steering drawn in, and the gauges of steering, throttle and speed.

// The stock camera's focal length over the picture's width, its height above the road and the horizon's share of the
// picture, from crates/sim's camera; wheelbase and full lock from crates/core's car.
const FOCAL = 138.56 / 320, ABOVE_M = 1.5, HORIZON = 0.385, WHEELBASE_M = 2.87, FULL_LOCK_DEG = 25;
const PATH_M = [4, 30];

const picture = { bitmap: null, busy: false, waiting: null };

// Decodes the newest picture; those that come meanwhile replace one another.
async function showPicture(bytes) {
  picture.waiting = bytes;
  if (picture.busy) return;
  picture.busy = true;
  while (picture.waiting) {
    const blob = new Blob([picture.waiting], { type: "image/jpeg" });
    picture.waiting = null;
    try {
      const bitmap = await createImageBitmap(blob);
      picture.bitmap?.close();
      picture.bitmap = bitmap;
    } catch {
      picture.bitmap = null; // not a JPEG: the bridge says so among the events
    }
  }
  picture.busy = false;
}

// The path of the front wheels on flat ground, as the camera sees it.
function drawPath(context, width, height, steering, colour, line) {
  const bend = Math.tan((steering * FULL_LOCK_DEG * Math.PI) / 180) / WHEELBASE_M;
  context.beginPath();
  for (let m = PATH_M[0]; m <= PATH_M[1]; m++) {
    const x = width / 2 + (FOCAL * width * bend * m * m) / 2 / m;
    const y = HORIZON * height + (FOCAL * width * ABOVE_M) / m;
    if (m === PATH_M[0]) context.moveTo(x, y); else context.lineTo(x, y);
  }
  context.strokeStyle = colour;
  context.lineWidth = line;
  context.lineCap = "round";
  context.stroke();
}

function drawNoPicture(context, width, height) {
  context.fillStyle = colours.road;
  context.fillRect(0, 0, width, height);
  context.fillStyle = colours.faint;
  context.font = "14px system-ui, sans-serif";
  context.textAlign = "center";
  context.fillText("no picture", width / 2, height / 2);
}

function drawCamera(turn) {
  const canvas = $("camera"), { context, width, height } = sharp(canvas);
  context.clearRect(0, 0, width, height);
  if (picture.bitmap) {
    context.drawImage(picture.bitmap, 0, 0, width, height);
    if (looking.bitmap) context.drawImage(looking.bitmap, 0, 0, width, height);
  } else {
    drawNoPicture(context, width, height);
  }
  if (!turn) return;
  if (known(turn.steering_deg)) drawPath(context, width, height, turn.steering_deg / FULL_LOCK_DEG, "rgba(255,255,255,.75)", 6);
  if (turn.command) drawPath(context, width, height, turn.command[0], "#ff7a45", 3);
}

// A bar from a middle: for steering to both sides, for throttle and brake.
function bar(name, words) {
  const fill = el("i"), value = el("b", {}, "–");
  const node = el("div", { class: "bar", role: "meter", "aria-label": name, "aria-valuemin": -1, "aria-valuemax": 1 },
    el("span", {}, name), el("div", { class: "track" }, el("u"), fill), value);
  const show = (share) => {
    const there = known(share), by = there ? Math.min(1, Math.max(-1, share)) : 0;
    fill.style.left = 50 + Math.min(0, 50 * by) + "%";
    fill.style.width = 50 * Math.abs(by) + "%";
    fill.classList.toggle("below", by < 0);
    say(value, there ? words(share) : "–");
    if (there) node.setAttribute("aria-valuenow", share.toFixed(2)); else node.removeAttribute("aria-valuenow");
  };
  return { node, show };
}

// Half a circle for the speed, with a mark at the set speed.
function dial() {
  const canvas = el("canvas"), value = el("b", {}, "–"), set = el("span");
  const node = el("div", { class: "dial", role: "meter", "aria-label": "Speed, mph", "aria-valuemin": 0 },
    canvas, el("p", {}, value, el("small", {}, " mph")), set);
  const show = (mph, setMph) => {
    const { context, width, height } = sharp(canvas);
    const most = Math.max(30, Math.ceil((1.2 * (setMph ?? 0)) / 10) * 10), r = Math.max(1, Math.min(width / 2, height) - 8);
    const [x, y] = [width / 2, height - 4], angle = (v) => Math.PI * (1 + Math.min(1, Math.max(0, v / most)));
    const arc = (from, to, colour, w) => {
      context.beginPath();
      context.arc(x, y, r, from, to);
      context.strokeStyle = colour;
      context.lineWidth = w;
      context.stroke();
    };
    context.clearRect(0, 0, width, height);
    context.lineCap = "butt";
    arc(Math.PI, 2 * Math.PI, colours.line, 9);
    if (known(mph)) arc(Math.PI, angle(mph), colours.a, 9);
    if (known(setMph)) arc(angle(setMph) - 0.03, angle(setMph) + 0.03, colours.b, 17);
    say(value, fixed(mph, 1));
    say(set, known(setMph) ? `set ${+setMph.toFixed(1)} mph` : "");
    node.setAttribute("aria-valuemax", most);
    if (known(mph)) node.setAttribute("aria-valuenow", mph.toFixed(1)); else node.removeAttribute("aria-valuenow");
  };
  return { node, show };
}

const gauges = {
  speed: dial(),
  steering: bar("Steering", (share) => `${Math.abs(share * FULL_LOCK_DEG).toFixed(1)}° ${Math.abs(share) < 0.002 ? "" : share < 0 ? "left" : "right"}`.trim()),
  throttle: bar("Throttle", (share) => `${share < 0 ? "brake " : ""}${Math.abs(100 * share).toFixed(0)} %`),
};
$("gauges").append(gauges.speed.node, el("div", { class: "bars" }, gauges.steering.node, gauges.throttle.node));

const HANDS = { pilot: "the pilot is driving", human: "a person is driving", off: "pilot off: re-arm", stopped: "emergency stop: re-arm" };

function drawGauges(turn, status) {
  const phase = status?.phase;
  const words = status?.paused ? "paused" : phase === "waiting" ? "waiting for the model" : phase === "ended" ? "run ended: the car is stopped" : HANDS[status?.hands] ?? "";
  say($("hands"), words);
  $("hands").dataset.hands = phase === "driving" ? status.hands : "off";
  gauges.speed.show(turn?.speed_mph, status?.set_speed_mph);
  gauges.steering.show(turn?.command?.[0] ?? (known(turn?.steering_deg) ? turn.steering_deg / FULL_LOCK_DEG : null));
  gauges.throttle.show(turn?.command?.[1] ?? turn?.throttle);
  const facts = turn ? [clock(turn.t), known(turn.lap) ? `lap ${turn.lap + 1}` : "", known(turn.cte) ? `${Math.abs(turn.cte).toFixed(2)} m off the line` : ""] : [];
  say($("facts"), facts.filter(Boolean).join(" · "));
}
