"use strict";
// What a person may change. A control that the drive does not have is disabled, and says why.
const token = new URLSearchParams(location.search).get("token") ?? sessionStorage.getItem("token");
if (token) {
  sessionStorage.setItem("token", token);
  // The secret need not stand in the address, nor in the history.
  history.replaceState(null, "", location.pathname);
}
// The headers of every request.
const bearer = token ? { Authorization: `Bearer ${token}` } : {};
const wants = { drive: null, status: null, touched: new Map() };
// Which control each element belongs to.
const PARTS = {
  stop: "stop", "take-over": "take-over", arm: "arm", mph: "set-speed", "mph-slider": "set-speed", law: "speed-law", pilot: "pilot",
  steer: "steer", "start-run": "start-run", "end-run": "end-run", record: "record", pause: "pause", step: "step", reset: "reset",
  track: "world", seed: "world", scenario: "world", apply: "world",
};

async function whyRefused(response) {
  return (await response.json().catch(() => null))?.error ?? `refused: ${response.status}`;
}

// Whether it was granted.
async function ask(control) {
  if (wants.drive === null) return;
  try {
    const response = await fetch(`api/drives/${wants.drive}/control`, {
      method: "POST", body: JSON.stringify(control),
      headers: { "Content-Type": "application/json", ...bearer },
    });
    say($("answer"), response.ok ? "" : await whyRefused(response));
    return response.ok;
  } catch {
    say($("answer"), "Lapwing does not answer: is it still running?");
  }
}

// What a person has just set stays as they set it until the drive says so, too, or three seconds have passed.
const touch = (id) => wants.touched.set(id, performance.now());
const isTouched = (id) => document.activeElement === $(id) && performance.now() - (wants.touched.get(id) ?? -Infinity) < 3000;
const put = (id, value) => { if (!isTouched(id) && $(id).value !== String(value)) $(id).value = value; };

function options(select, names, values = names) {
  const key = JSON.stringify([names, values]);
  if (select.dataset.key === key) return;
  select.dataset.key = key;
  select.replaceChildren(...names.map((name, i) => el("option", { value: values[i] }, name)));
}

function showControls(drive, status, pilots) {
  [wants.drive, wants.status] = [drive, status];
  const can = status?.can ?? {}, running = status?.phase === "driving";
  for (const [id, control] of Object.entries(PARTS)) {
    let why = status ? (can[control] ?? null) : "nothing is driving";
    if (!why && id === "start-run" && running) why = "a run is already under way";
    if (!why && id === "end-run" && !running) why = "no run is under way";
    $(id).disabled = why !== null;
    $(id).title = why ?? "";
  }
  const world = status ? (can.world ?? null) : "nothing is driving";
  say($("world-why"), world ?? "");
  $("world-why").hidden = world === null;
  say($("run-why"), (status && can["start-run"]) ?? "");
  const file = running ? status.file : null, lost = file?.not_recorded ?? 0;
  say($("unwritten"), file?.trouble ? `this run is not being written: ${file.trouble}` : "");
  say($("lost"), lost ? `not recorded of this run: ${lost} frame${lost > 1 ? "s and other items" : " or other item"}` : "");
  $("record").hidden = Boolean(can.record);
  if (!status) return;
  put("mph", +status.set_speed_mph.toFixed(1));
  put("mph-slider", status.set_speed_mph);
  say($("mph-now"), `${+status.set_speed_mph.toFixed(1)} mph`);
  put("law", status.speed_law);
  options($("pilot"), pilots.length ? pilots.map(({ name }) => name) : ["still loading"], pilots.length ? pilots.map((_, i) => i) : [0]);
  put("pilot", status.pilot);
  $("pause").setAttribute("aria-pressed", status.paused);
  say($("pause"), status.paused ? "Resume" : "Pause");
  $("record").setAttribute("aria-pressed", status.recording);
  say($("record"), status.recording ? `Recording: ${status.recorded} rows` : `Record by hand${status.recorded ? ` (${status.recorded} rows)` : ""}`);
  $("arm").classList.toggle("due", ["off", "stopped"].includes(status.hands) && running);
  showWorld(status);
}

// Roads of which there is one for each seed, and whether the one that is chosen is of these.
const RANDOM = ["random", "random-lanes"];
const isRandom = () => RANDOM.includes($("track").value);

// Fields of the world are filled when the world changes, not under somebody's hands.
function showWorld({ offered, track, scenario, run }) {
  const key = JSON.stringify([offered, track, scenario, run]);
  if ($("world").dataset.key === key) return;
  $("world").dataset.key = key;
  options($("track"), [...offered.tracks, ...RANDOM], [...offered.tracks, ...RANDOM]);
  options($("scenario"), ["none", ...offered.scenarios], ["", ...offered.scenarios]);
  const [kind, seed] = (track ?? "").split(":");
  if (track) $("track").value = offered.tracks.includes(track) || RANDOM.includes(kind) ? kind : "random";
  if (RANDOM.includes(kind) && seed) $("seed").value = seed;
  $("scenario").value = scenario ?? "";
  $("seed").hidden = !isRandom();
  if ($("weather").childElementCount === offered.weather.length) return;
  $("weather").replaceChildren(...offered.weather.map(({ name, min, max, fair }) => {
    const step = max - min > 20 ? 1 : 0.05;
    const value = el("output", {}, String(fair)), slider = el("input", { type: "range", min, max, step, value: fair, "data-fair": fair, "data-name": name, id: `weather-${name}` });
    slider.addEventListener("input", () => say(value, slider.value));
    return el("label", { for: slider.id }, el("span", {}, name.replace("_deg", " °").replaceAll("_", " ")), slider, value);
  }));
}

const click = (id, control) => $(id).addEventListener("click", () => ask(typeof control === "function" ? control() : control));
click("stop", { control: "stop" });
click("take-over", { control: "take-over" });
click("arm", { control: "arm" });
click("start-run", { control: "start-run" });
click("end-run", { control: "end-run" });
click("pause", () => ({ control: wants.status?.paused ? "resume" : "pause" }));
click("step", { control: "step" });
click("reset", { control: "reset" });
click("record", () => ({ control: "record", on: !wants.status?.recording }));
click("apply", () => {
  const seed = isRandom() ? `:${Math.max(0, Math.floor(+$("seed").value || 0))}` : "";
  const track = $("track").value + seed;
  const sliders = [...$("weather").querySelectorAll("input")].filter((slider) => slider.value !== slider.dataset.fair);
  const weather = Object.fromEntries(sliders.map((slider) => [slider.dataset.name, +slider.value]));
  return { control: "world", track, scenario: $("scenario").value, weather };
});
$("track").addEventListener("change", () => { $("seed").hidden = !isRandom(); });
$("steer").addEventListener("click", () => { takeWheel(!wheel.on); $("steer").blur(); });

for (const id of ["mph", "mph-slider"]) {
  $(id).addEventListener("input", () => { touch(id); say($("mph-now"), `${$(id).value} mph`); });
  $(id).addEventListener("change", async () => {
    const asked = $(id).value;
    const asBefore = () => {
      wants.touched.delete(id);
      if ($(id).value !== asked) return; // another one is being typed
      $(id).value = wants.status ? +wants.status.set_speed_mph.toFixed(1) : "";
      say($("mph-now"), `${$(id).value} mph`);
    };
    if (asked === "") { // also if it is not a number
      say($("answer"), "set speed: expected a speed in mph, got nothing");
      return asBefore();
    }
    touch(id);
    if (!await ask({ control: "set-speed", mph: +asked })) asBefore();
  });
}
// What is refused does not stay chosen.
const choose = (id, control, now) => $(id).addEventListener("change", async () => {
  const asked = $(id).value;
  touch(id);
  if (await ask(control(asked)) || $(id).value !== asked) return; // or another one has been chosen since
  wants.touched.delete(id);
  if (wants.status) $(id).value = now(wants.status);
});
choose("law", (law) => ({ control: "speed-law", law }), (status) => status.speed_law);
choose("pilot", (index) => ({ control: "pilot", index: +index }), (status) => status.pilot);

addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.key === "Escape") ask({ control: "stop" });
  if ($("main").hidden) return;
  const writing = event.target instanceof HTMLElement && event.target.matches("input, select, textarea");
  if (event.code === "KeyH" && !writing && !$("steer").disabled) { event.preventDefault(); takeWheel(!wheel.on); }
});
showControls(null, null, []);
