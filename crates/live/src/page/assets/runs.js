"use strict";
// Recorded runs: a list with pictures and scores. Clicked, one is played (player.js).
const runs = { listed: "", names: [] };
const GLANCE = ["completion", "collisions", "off the road", "|cte|", "autonomy", "distance", "speed"];

const secret = () => (token ? `?token=${encodeURIComponent(token)}` : "");
const pathOf = (name, rest = "") => `api/runs/${encodeURIComponent(name)}${rest}`;
async function request(path, options = {}) {
  const response = await fetch(path, { headers: bearer, ...options });
  if (!response.ok) throw new Error(await whyRefused(response));
  return response;
}

function showView(which) {
  const past = which === "runs";
  $("main").hidden = past;
  $("tabs").hidden = past;
  $("runs").hidden = !past;
  $("to-live").setAttribute("aria-pressed", !past);
  $("to-runs").setAttribute("aria-pressed", past);
  takeWheel(false);
  play(false);
  if (past) { listRuns(); listModels(); } else draw();
}
$("to-live").addEventListener("click", () => showView("live"));
$("to-runs").addEventListener("click", () => showView("runs"));

async function listRuns() {
  let listed;
  try {
    listed = await (await request("api/runs")).json();
    say($("runs-answer"), listed.length ? "" : "No run is in the folder yet.");
  } catch (error) {
    say($("runs-answer"), error.message);
    return;
  }
  const key = JSON.stringify(listed);
  if (key === runs.listed) return;
  runs.listed = key;
  runs.names = listed.map(({ name }) => name);
  listSecond();
  const rows = listed.map(({ name, bytes, modified_s }) => {
    const when = new Date(1000 * modified_s).toLocaleString(), words = el("span", { class: "readout" }, "…"), image = el("img", { alt: "", width: 120, height: 60 });
    const button = el("button", { "data-name": name, "aria-current": name === player.first?.name }, image, el("span", {}, el("strong", {}, name.replace(/\.mcap$/, "")), el("small", {}, `${when} · ${(bytes / 2 ** 20).toFixed(1)} MiB`), words));
    button.addEventListener("click", () => openRun(name));
    return { name, words, image, node: el("li", {}, button) };
  });
  $("run-list").replaceChildren(...rows.map(({ node }) => node));
  // One after the other: each is read from its beginning to its end.
  for (const { name, words, image } of rows) {
    if (runs.listed !== key || $("runs").hidden) { runs.listed = ""; return; }
    try {
      const glance = await (await request(pathOf(name, "/glance"))).json();
      say(words, glance.rows.filter(([row]) => GLANCE.includes(row)).map(([row, value]) => `${row} ${value}`).join(" · "));
      image.onload = () => URL.revokeObjectURL(image.src);
      const picture = await request(pathOf(name, "/glance/picture")).catch(() => null); // a run may have none
      if (picture) image.src = URL.createObjectURL(await picture.blob());
    } catch (error) {
      say(words, error.message);
    }
  }
}
