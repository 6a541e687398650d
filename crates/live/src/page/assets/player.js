"use strict";
// The player: one run, or two that play together; frame by frame, with their events, curves and map.
// The first run's colour is b, as the command's is on the live page; the second's is a.
const player = { opening: null, first: null, second: null, together: null, ticks: [], index: 0, playing: null };
const PATHS = { first: "#ff7a45", second: "#4cc3e8", model: "#c792ff" };

// A run with its canvas; of the frames and layers that are wanted, the newest is fetched, one at a time.
const side = (canvas, facts, colour) => ({ canvas: $(canvas), facts: $(facts), colour, run: null, frame: 0, bitmap: null, layer: null, wanted: null, fetching: false });
const sides = [side("frame", "run-facts", PATHS.first), side("frame-2", "run-facts-2", PATHS.second)];

// A run as the player needs it: with its commands apart, and how far along the track it was.
async function readRun(name) {
  const run = await (await request(pathOf(name))).json();
  run.command = { t: run.commands.map(([t]) => t), steering: run.commands.map(([, steering]) => steering) };
  run.along = alongOf(run);
  return run;
}

async function openRun(name) {
  play(false);
  stopComparing();
  player.opening = name;
  if (!models.list.length) listModels(); // they may have been loaded since
  say($("runs-answer"), `reading ${name} …`);
  let run;
  try {
    run = await readRun(name);
  } catch (error) {
    if (player.opening === name) say($("runs-answer"), error.message);
    return;
  }
  if (player.opening !== name) return; // something else was chosen meanwhile
  say($("runs-answer"), "");
  [player.first, player.second] = [run, null];
  $("player").hidden = false;
  say($("run-title"), player.first.title);
  for (const node of $("run-list").querySelectorAll("button")) node.setAttribute("aria-current", node.dataset.name === name);
  $("run-file").href = pathOf(name, "/file") + secret();
  $("run-report").href = pathOf(name, "/report") + secret();
  listSecond();
  showRuns();
  seek(0);
  $("player").scrollIntoView({ block: "start" });
}

async function openSecond(name) {
  play(false);
  const { first } = player;
  player.second = null;
  if (name) {
    say($("runs-answer"), `reading ${name} …`);
    try {
      const second = await readRun(name);
      if (player.first !== first || $("second").value !== name) return; // something else was chosen meanwhile
      player.second = second;
      say($("runs-answer"), "");
    } catch (error) {
      $("second").value = "";
      say($("runs-answer"), error.message);
    }
  }
  const t = player.ticks[player.index] ?? 0;
  showRuns();
  seek(before(player.ticks, t));
}
$("second").addEventListener("change", () => openSecond($("second").value));
$("align").addEventListener("change", () => { play(false); showRuns(); seek(0); });

function listSecond() {
  const others = runs.names.filter((name) => name !== player.first?.name);
  options($("second"), ["none", ...others.map((name) => name.replace(/\.mcap$/, ""))], ["", ...others]);
  $("second").value = player.second?.name ?? "";
}

// Lays out what depends on which runs are shown, and how they are aligned.
function showRuns() {
  const { first, second } = player;
  const why = second && whyNotByPlace(first, second);
  $("align-pair").hidden = !second;
  $("align").querySelector("[value=place]").disabled = Boolean(why);
  if (why) $("align").value = "time";
  say($("align-why"), why ?? "");
  player.together = second && together(first, second, $("align").value);
  const end = first.frames_s.at(-1) ?? 0;
  // Where the second run goes on after the first has ended, its frames go on.
  const rest = second && $("align").value === "time" ? second.frames_s.filter((t) => t > end) : [];
  player.ticks = [...first.frames_s, ...rest];
  Object.assign($("time"), { min: 0, max: Math.max(0, player.ticks.length - 1) });
  $("time").disabled = player.ticks.length < 2;
  [sides[0].run, sides[1].run] = [first, second];
  for (const side of sides) side.layer = null;
  $("figure-2").hidden = !second;
  $("figures").classList.toggle("two", Boolean(second));
  say($("name-1"), second ? first.name.replace(/\.mcap$/, "") : "");
  say($("name-2"), second ? second.name.replace(/\.mcap$/, "") : "");
  showEventsOf(first, second);
  showScores(first, second);
  runCurves();
}

// The tick at which the second run is at its time t.
const tickOfSecond = (t) => Math.max(0, player.ticks.findLastIndex((tick) => player.together.timeOf(tick) <= t + 1e-6));
const tickOf = (run, t) => (run === player.first ? before(player.ticks, t) : tickOfSecond(t));

function showEventsOf(...shown) {
  const there = shown.filter(Boolean), last = Math.max(1, player.ticks.length - 1);
  $("marks-2").hidden = there.length < 2;
  ["marks", "marks-2"].forEach((row, i) => {
    const run = there[i], marks = run?.drawn.events.filter(({ kind }) => kind !== "run-ended") ?? [];
    $(row).replaceChildren(...marks.map(({ t, kind, words }) => {
      const mark = el("i", { "data-kind": kind, title: `${clock(t)} ${words}` });
      mark.style.left = `${Math.min(100, (100 * tickOf(run, t)) / last)}%`;
      return mark;
    }));
  });
  const all = there.flatMap((run, i) => run.drawn.events.map((event) => ({ ...event, run, tick: tickOf(run, event.t), which: i + 1 })));
  all.sort((a, b) => a.tick - b.tick);
  $("run-events").replaceChildren(...(all.length ? all.map(({ t, kind, words, tick, which }) => {
    const of = there.length > 1 ? [el("b", { class: `which run-${which}` }, `run ${which}`)] : [];
    const button = el("button", { "data-kind": kind }, el("time", {}, clock(t)), ...of, words);
    button.addEventListener("click", () => { play(false); seek(tick); });
    return el("li", {}, button);
  }) : [el("li", { class: "none" }, "nothing happened")]));
}

function showScores(first, second) {
  const named = ({ rows }) => rows.map(([row, words], i) => [row || " ".repeat(i + 1), words]); // those without a name stay apart
  const rows = new Map(named(first).map(([row, words]) => [row, [words]]));
  if (second) named(second).forEach(([row, words]) => rows.set(row, [rows.get(row)?.[0] ?? "–", words]));
  const count = second ? 2 : 1, head = second ? [el("dt", {}, ""), el("dd", { class: "which run-1" }, "run 1"), el("dd", { class: "which run-2" }, "run 2")] : [];
  $("run-score").classList.toggle("two", Boolean(second));
  $("run-score").replaceChildren(...head, ...[...rows].flatMap(([row, words]) => [el("dt", {}, row), ...Array.from({ length: count }, (_, i) => el("dd", {}, words[i] ?? "–"))]));
}

// What is true of a run at its time t, for people.
function factsOf({ drawn, frames_s, command }, t, frame) {
  const i = before(drawn.t, t), steering = commandAt({ command, drawn }, t);
  return [clock(t), frames_s.length ? `frame ${frame + 1} of ${frames_s.length}` : "no picture", known(drawn.speed[i]) ? `${drawn.speed[i].toFixed(1)} mph` : "", known(steering) ? `${(FULL_LOCK_DEG * steering).toFixed(1)}°` : "", known(drawn.cte[i]) ? `${Math.abs(drawn.cte[i]).toFixed(2)} m off the line` : ""].filter(Boolean);
}

// The command at t, normalised; what the simulator reports where none is recorded.
function commandAt({ command, drawn }, t) {
  const reported = drawn.steering[before(drawn.t, t)];
  return command.t.length ? command.steering[before(command.t, t)] : known(reported) ? reported / FULL_LOCK_DEG : null;
}

// The time of each run at a tick.
const timesAt = (tick) => [tick, player.together?.timeOf(tick) ?? 0];

function seek(index) {
  if (!player.first) return;
  player.index = Math.min(Math.max(0, index), Math.max(0, player.ticks.length - 1));
  $("time").value = player.index;
  const times = timesAt(player.ticks[player.index] ?? 0);
  const facts = sides.map((side, i) => {
    if (!side.run) return [];
    side.frame = before(side.run.frames_s, times[i]);
    const facts = factsOf(side.run, Math.min(times[i], side.run.drawn.t.at(-1) ?? 0), side.frame);
    say(side.facts, facts.join(" · "));
    fetchFrame(side);
    return facts;
  });
  $("time").setAttribute("aria-valuetext", facts.filter((some) => some.length).map((some) => some.join(", ")).join("; "));
  drawCursor();
  drawRunMap(times);
}

// The newest picture that is wanted, and then the layer over it.
async function fetchFrame(side) {
  const there = side.run?.frames_s.length > 0;
  side.wanted = there ? side.frame : null;
  if (side.run && !there) drawFrame(side);
  if (side.fetching || !there) return;
  side.fetching = true;
  while (side.wanted !== null && side.run) {
    const { run } = side, n = side.wanted;
    side.wanted = null;
    try {
      if (side.bitmap?.of !== run || side.bitmap.n !== n) {
        const bitmap = await createImageBitmap(await (await request(pathOf(run.name, `/frames/${n}`))).blob());
        if (side.run !== run) { bitmap.close(); continue; }
        side.bitmap?.bitmap.close();
        side.bitmap = { bitmap, n, of: run };
        if (!player.playing && side.layer?.n !== n) side.layer = null;
        drawFrame(side);
      }
      await fetchLayer(side, n);
      if (side.run === run) drawFrame(side);
    } catch (error) {
      say($("runs-answer"), error.message);
    }
  }
  side.fetching = false;
}

function drawFrame(side) {
  if (!side.run) return;
  if (!side.run.frames_s.length) {
    const { context, width, height } = sharp(side.canvas);
    delete side.canvas.dataset.shown;
    delete side.canvas.dataset.layer;
    return drawNoPicture(context, width, height);
  }
  if (!side.bitmap || side.bitmap.of !== side.run) return;
  const { bitmap, n } = side.bitmap, { context, width, height } = sharp(side.canvas), t = side.run.frames_s[n];
  context.drawImage(bitmap, 0, 0, width, height);
  if (side.layer) context.drawImage(side.layer.bitmap, 0, 0, width, height);
  const steering = commandAt(side.run, t), model = side === sides[0] ? modelAt(t) : null;
  if (known(steering)) drawPath(context, width, height, steering, side.colour, 3);
  if (known(model)) drawPath(context, width, height, model, PATHS.model, 3);
  side.canvas.dataset.shown = n;
  side.canvas.dataset.layer = side.layer?.n ?? "";
}
const redraw = () => { sides.forEach((side) => side.run && drawFrame(side)); if (player.first) drawRunMap(timesAt(player.ticks[player.index] ?? 0)); };
addEventListener("resize", redraw);
dark.addEventListener("change", redraw);

function drawRunMap(times) {
  const { first, second } = player;
  const shown = [first, second].map((run, i) => {
    if (!run) return null;
    const at = before(run.drawn.t, times[i]);
    return { trail: run.drawn.at.slice(0, at + 1).filter(Boolean), place: run.drawn.at[at] ? { at: run.drawn.at[at] } : null, colour: i ? "a" : "b" };
  });
  const onOneMap = second && first.card.track === second.card.track;
  drawTrack($("run-map"), first.outline, shown[0].trail, shown[0].place, onOneMap ? shown[1] : null, "b");
}

function play(on) {
  if (on === Boolean(player.playing)) return;
  say($("play"), on ? "Pause" : "Play");
  $("play").setAttribute("aria-pressed", on);
  cancelAnimationFrame(player.playing?.frame);
  player.playing = null;
  if (!player.first) return;
  if (!on) return seek(player.index); // with the layer of this very frame
  if (player.index >= player.ticks.length - 1) seek(0);
  player.playing = { from: performance.now(), at: player.ticks[player.index] ?? 0 };
  const step = (now) => {
    if (!player.playing) return;
    const index = before(player.ticks, player.playing.at + (now - player.playing.from) / 1000);
    if (index !== player.index) seek(index);
    if (index >= player.ticks.length - 1) return play(false);
    player.playing.frame = requestAnimationFrame(step);
  };
  player.playing.frame = requestAnimationFrame(step);
}
$("play").addEventListener("click", () => play(!player.playing));
const step = (by) => { play(false); seek(player.index + by); };
$("back").addEventListener("click", () => step(-1));
$("forth").addEventListener("click", () => step(1));
$("time").addEventListener("input", () => { const index = +$("time").value; play(false); seek(index); });
