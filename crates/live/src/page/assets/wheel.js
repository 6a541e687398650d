"use strict";
// Driving by hand: keys or a gamepad, as commands 30 times a second.
const SEND_MS = 33;
// Full lock per second: to a side, and back to the middle.
const TURNS = 1.6, RETURNS = 3.5;
const DEAD_ZONE = 0.08;
const KEYS = { ArrowLeft: "left", KeyA: "left", ArrowRight: "right", KeyD: "right", ArrowUp: "faster", KeyW: "faster", ArrowDown: "slower", KeyS: "slower", Space: "slower" };

const wheel = { on: false, down: new Set(), steering: 0, timer: null, say: () => {} };

function gamepad() {
  for (const pad of navigator.getGamepads?.() ?? []) if (pad?.connected) return pad;
  return null;
}

// Firefox, for one, has gamepads only for pages of this machine or with https.
const wheelHint = () => gamepad() ? "gamepad connected"
  : navigator.getGamepads ? "arrow keys or WASD, or a gamepad"
  : "arrow keys or WASD; this browser allows gamepads only on localhost or https: use an SSH tunnel";

function turnWheel() {
  const pad = gamepad();
  let throttle = (wheel.down.has("faster") ? 1 : 0) - (wheel.down.has("slower") ? 1 : 0), by = "keys";
  const side = (wheel.down.has("right") ? 1 : 0) - (wheel.down.has("left") ? 1 : 0), dt = SEND_MS / 1000;
  const back = Math.sign(wheel.steering) !== side || side === 0;
  if (back) wheel.steering -= Math.sign(wheel.steering) * Math.min(Math.abs(wheel.steering), RETURNS * dt);
  wheel.steering = Math.min(1, Math.max(-1, wheel.steering + side * TURNS * dt));
  let steering = wheel.steering;
  if (pad) {
    const axis = pad.axes[0] ?? 0, pedals = (pad.buttons[7]?.value ?? 0) - (pad.buttons[6]?.value ?? 0);
    if (Math.abs(axis) > DEAD_ZONE || pedals !== 0) {
      // Finer in the middle.
      steering = Math.sign(axis) * Math.max(0, (Math.abs(axis) - DEAD_ZONE) / (1 - DEAD_ZONE)) ** 1.5;
      [throttle, by] = [pedals, "gamepad"];
    }
  }
  wheel.say({ hand: { steering: +steering.toFixed(4), throttle: +throttle.toFixed(3) } });
  say($("wheel"), `${by}: steering ${(100 * steering).toFixed(0)} %, throttle ${(100 * throttle).toFixed(0)} %`);
}

function takeWheel(on) {
  if (on === wheel.on) return;
  wheel.on = on;
  wheel.down.clear();
  wheel.steering = 0;
  clearInterval(wheel.timer);
  $("steer").setAttribute("aria-pressed", on);
  if (on) {
    wheel.timer = setInterval(turnWheel, SEND_MS);
  } else {
    wheel.say({ hand: null });
    say($("wheel"), wheelHint());
  }
}

addEventListener("keydown", (event) => {
  if (!wheel.on || event.ctrlKey || event.metaKey || event.altKey || !KEYS[event.code]) return;
  event.preventDefault();
  wheel.down.add(KEYS[event.code]);
});
addEventListener("keyup", (event) => wheel.down.delete(KEYS[event.code]));
// Nobody drives who looks elsewhere.
addEventListener("blur", () => takeWheel(false));
document.addEventListener("visibilitychange", () => document.hidden && takeWheel(false));
addEventListener("gamepadconnected", () => wheel.on || say($("wheel"), "gamepad connected"));
say($("wheel"), wheelHint());
