"use strict";
// What the network looks at: a layer over the picture. Live, one after the other as the server makes them, beside the pictures;
// in the player, of the frame that is shown.
const LOOKS = {
  "visual-back-prop": "VisualBackProp: red is what its convolutions react to",
  "integrated-gradients": "integrated gradients: red turns right, blue turns left",
};
const LIVE_LOOKS_MS = 250;
const looking = { bitmap: null, running: false };

async function getLayer(path) {
  return createImageBitmap(await (await request(path)).blob());
}

// Why the drive's pilot cannot be looked into; null if it can.
function whyNotLive() {
  const { status, pilots, watched } = live;
  if (watched === null || !status) return "nothing is driving";
  return pilots.length ? (pilots[status.pilot]?.unexplained ?? null) : "the model is still loading";
}

function showLooks() {
  const why = whyNotLive(), select = $("live-looks");
  select.disabled = why !== null;
  say($("live-looks-says"), why ?? LOOKS[select.value] ?? "");
  if (why !== null || !select.value) forgetLooks(); else lookLive();
}

function forgetLooks() {
  looking.bitmap?.close();
  looking.bitmap = null;
  $("camera").dataset.layers = 0;
}

async function lookLive() {
  if (looking.running) return;
  looking.running = true;
  const wanted = () => $("live-looks").value && !$("live-looks").disabled && !$("main").hidden && !document.hidden;
  for (let how; (how = wanted()); await new Promise((on) => setTimeout(on, LIVE_LOOKS_MS))) {
    const drive = live.watched;
    if (!picture.bitmap || !live.turn) continue;
    try {
      const bitmap = await getLayer(`api/drives/${drive}/explained/${$("live-looks").value}`);
      if (!wanted() || live.watched !== drive) { bitmap.close(); continue; }
      looking.bitmap?.close();
      looking.bitmap = bitmap;
      say($("live-looks-says"), LOOKS[$("live-looks").value]);
      $("camera").dataset.layers = 1 + +($("camera").dataset.layers ?? 0);
      draw();
    } catch (error) {
      say($("live-looks-says"), error.message);
    }
  }
  looking.running = false;
}
$("live-looks").addEventListener("change", () => { forgetLooks(); showLooks(); draw(); });
document.addEventListener("visibilitychange", () => document.hidden || showLooks());

// Whose look is shown of a run: that of the model it is compared with, else that of its own.
function looker(run) {
  const own = models.list.findIndex(({ sha256 }) => sha256 !== null && sha256 === run.model_sha256);
  const index = $("against").value === "" ? own : +$("against").value, model = models.list[index];
  if (!model) return { why: "the network that drove is not among the server's: choose another model above" };
  return model.unexplained ? { why: model.unexplained } : { index, name: model.name };
}

// The layer for the frame n, if one is wanted.
async function fetchLayer(side, n) {
  const how = $("looks").value, { run } = side;
  const drop = () => { side.layer?.bitmap.close(); side.layer = null; };
  if (!how) { drop(); if (side === sides[0]) say($("looks-says"), ""); return; }
  const { index, name, why } = looker(run);
  if (side === sides[0]) say($("looks-says"), why ?? `${name}, ${LOOKS[how]}`);
  if (why) return drop();
  if (side.layer?.n === n && side.layer.of === run && side.layer.how === how && side.layer.index === index) return;
  const bitmap = await getLayer(pathOf(run.name, `/frames/${n}/explained/${how}/${index}`));
  drop();
  if (side.run === run && $("looks").value === how) side.layer = { bitmap, n, of: run, how, index }; else bitmap.close();
}
$("looks").addEventListener("change", () => seek(player.index));
