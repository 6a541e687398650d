"use strict";
// The connection, and what comes over it. Everything a drive says may be missing: null is "not told".
const live = { socket: null, status: null, pilots: [], turn: null, watched: null, drives: [], wait: 500, events: [], drawn: 0, dirty: false, card: null };
const EVENTS = 60;
const CURVES_MS = 100;

function tell(message) {
  if (live.socket?.readyState === WebSocket.OPEN) live.socket.send(JSON.stringify(message));
}
wheel.say = tell;

function connect() {
  const scheme = location.protocol === "https:" ? "wss" : "ws", socket = new WebSocket(`${scheme}://${location.host}/live${secret()}`);
  socket.binaryType = "arraybuffer";
  live.socket = socket;
  socket.addEventListener("open", () => { live.wait = 500; linked(true); });
  socket.addEventListener("message", ({ data }) => (typeof data === "string" ? hear(JSON.parse(data)) : showPicture(data).then(draw)));
  socket.addEventListener("close", () => {
    linked(false);
    takeWheel(false);
    setTimeout(connect, live.wait);
    live.wait = Math.min(5000, 2 * live.wait);
  });
}

function linked(there) {
  $("link").classList.toggle("there", there);
  say($("link"), there ? "connected" : token ? "not connected" : "not connected: is Lapwing running? On another machine, open the address with the token that it printed");
  if (!there) showTabs([], null);
}

const HEARD = {
  drives: ({ drives, watched }) => showTabs(drives, watched),
  status: ({ drive, status, pilots }) => {
    if (isOver()) return;
    const before = live.status?.run;
    [live.status, live.pilots] = [status, pilots];
    if (before !== status.run) listEvents();
    if (known(before) && before !== status.run) { forgetTrail(); forgetMinute(); }
    showControls(drive, status, pilots);
    showLooks();
  },
  course: ({ course }) => showCourse(course),
  // What was driven before this page began to watch.
  minute: ({ turns }) => {
    forgetMinute(); forgetTrail();
    for (const [t, speed_mph, set_speed_mph, steering_deg, steering, throttle, x, z] of turns) {
      addToMinute({ t, speed_mph, steering_deg, command: known(steering) ? [steering, throttle] : null, throttle }, { set_speed_mph });
      addToTrail(known(x) ? { at: [x, z], off_m: null } : null);
    }
  },
  events: ({ events }) => showEvents(events),
  score: ({ score }) => showScore(score),
  wheel: ({ why }) => { takeWheel(false); say($("answer"), why); },
  moment: ({ message, turn, place }) => {
    // Seen, even if it is not drawn: the next one may come.
    tell({ seen: message });
    if (isOver()) return;
    live.turn = turn;
    if (turn) addToMinute(turn, live.status);
    addToTrail(place);
  },
};

function hear(message) {
  HEARD[message.kind]?.(message);
  draw();
}

// Whether what is watched has left.
const isOver = () => !live.drives.some(({ id }) => id === live.watched);

function showTabs(drives, watched) {
  const isOther = watched !== live.watched;
  [live.drives, live.watched] = [drives, watched];
  if (isOther) {
    live.card = null;
    live.events.length = 0;
    picture.bitmap = null;
    forgetMinute(); forgetTrail(); showCourse(null); listScore([]); showLatency();
  }
  if (isOther || isOver()) { // of one that has left the last picture stays, but there is nothing to control
    [live.status, live.turn] = [null, null];
    takeWheel(false);
    listEvents();
    showControls(null, null, []);
    showLooks();
  }
  $("nobody").hidden = drives.length > 0;
  document.body.classList.toggle("empty", drives.length === 0);
  $("tabs").replaceChildren(...drives.map(({ id, title }) => {
    const tab = el("button", { role: "tab", "aria-selected": id === watched, tabindex: id === watched ? 0 : -1 }, title);
    tab.addEventListener("click", () => watch(id));
    return tab;
  }));
}

function watch(id) {
  if (id === live.watched) return;
  tell({ watch: id });
  showTabs(live.drives, id);
}
$("tabs").addEventListener("keydown", ({ key }) => {
  const step = { ArrowLeft: -1, ArrowRight: 1 }[key], at = live.drives.findIndex(({ id }) => id === live.watched);
  const next = step && live.drives[at + step];
  if (next) { watch(next.id); $("tabs").children[at + step].focus(); }
});

function showEvents(events) {
  live.events = [...live.events, ...events].slice(-EVENTS);
  listEvents();
}

// Those of the newest run: their times are counted from its beginning.
function listEvents() {
  const run = live.status?.run ?? live.events.at(-1)?.run;
  const rows = live.events.filter((event) => event.run === run).toReversed().map(({ t, kind, words }) => el("li", { "data-kind": kind }, el("time", {}, clock(t)), words));
  $("events").replaceChildren(...(rows.length ? rows : [el("li", { class: "none" }, "none yet")]));
}

function showScore({ card, rows }) {
  live.card = card;
  listScore(rows);
  showLatency();
}

function listScore(rows) {
  const told = rows.filter(([name]) => name !== "latency");
  $("score").replaceChildren(...(told.length ? told.flatMap(([name, words]) => [el("dt", {}, name), el("dd", {}, words)]) : [el("dt", {}, "nothing yet"), el("dd")]));
}

const STAGES = ["decode", "preprocess", "forward", "driver", "answer"];
function showLatency() {
  const stages = live.card?.latency_ms ?? {}, most = Math.max(1, ...STAGES.map((stage) => stages[stage]?.p99 ?? 0));
  const rows = STAGES.filter((stage) => stages[stage]).map((stage) => {
    const { p50, p95, p99 } = stages[stage], fill = el("i"), tail = el("u");
    fill.style.width = `${(100 * p50) / most}%`;
    tail.style.width = `${(100 * p99) / most}%`;
    return el("tr", {}, el("th", { scope: "row" }, stage), el("td", { class: "share" }, el("div", {}, tail, fill)), ...[p50, p95, p99].map((ms) => el("td", {}, ms.toFixed(2))));
  });
  const head = el("tr", {}, el("th", {}, "ms"), el("th"), ...["p50", "p95", "p99"].map((name) => el("th", { scope: "col" }, name)));
  $("latency").replaceChildren(rows.length ? el("table", {}, el("thead", {}, head), el("tbody", {}, ...rows)) : el("p", { class: "readout" }, "no answers yet"));
}

// Once a frame of the screen, however often something comes; the curves ten times a second.
function draw() {
  if (live.dirty) return;
  live.dirty = true;
  requestAnimationFrame((now) => {
    live.dirty = false;
    if ($("main").hidden) return;
    drawCamera(live.turn);
    drawGauges(live.turn, live.status);
    say($("hz"), live.turn ? `${live.turn.hz.toFixed(1)} frames a second` : "");
    if (now - live.drawn > CURVES_MS) {
      live.drawn = now;
      drawCurves.forEach((curve) => curve());
      drawMap();
    }
  });
}
dark.addEventListener("change", () => { live.drawn = 0; draw(); });
addEventListener("resize", () => { live.drawn = 0; draw(); });

// The bridge is where this page came from; a browser leaves port 80 out of an address.
say($("connect"), `lapwing simulate --connect ${location.hostname}:${location.port || 80}`);
listScore([]);
showTabs([], null);
connect();
