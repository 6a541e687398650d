"use strict";
// Another model's steering on the frames of the first run, as the server computes it.
const compared = { name: "", t: [], steering: [], stop: null, drawn: 0 };
const models = { list: [] };

async function listModels() {
  try {
    models.list = (await (await request("api/state")).json()).pilots;
  } catch (error) {
    say($("runs-answer"), error.message);
    return;
  }
  options($("against"), ["none", ...models.list.map(({ name }) => name)], ["", ...models.list.keys()]);
  // A pilot that drives by the road itself has nothing to say of a picture.
  models.list.forEach(({ blind }, i) => Object.assign($("against").options[i + 1], { disabled: Boolean(blind), title: blind ?? "" }));
  say($("against-says"), models.list.length ? "" : "the model is still loading");
}

function stopComparing() {
  compared.stop?.abort();
  Object.assign(compared, { name: "", t: [], steering: [], stop: null });
  $("against").value = "";
  $("against-says").dataset.done = "";
  say($("against-says"), "");
}

function modelAt(t) {
  const i = before(compared.t, t);
  return compared.t.length && Math.abs(compared.t[i] - t) < 0.5 ? compared.steering[i] : null;
}

function sayAgreement({ agreement, done }, moments) {
  const { t } = compared, so = done ? `${t.length} frames` : known(moments) ? `${t.length} of ${moments} frames` : `${t.length} frames so far`;
  const { mae, r } = agreement ?? {};
  const words = agreement ? `mean absolute difference ${(FULL_LOCK_DEG * mae).toFixed(2)}° (${mae.toFixed(4)}), correlation ${known(r) ? r.toFixed(3) : "–"}` : "nobody has steered yet";
  say($("against-says"), `${words} · ${so}`);
  $("against-says").dataset.done = done ? "done" : "";
}

async function compareWith(index) {
  stopComparing();
  runCurves();
  $("against").value = index;
  if (index === "" || !player.first) return;
  const { name } = player.first, stop = new AbortController();
  compared.stop = stop;
  compared.name = models.list[index].name;
  let moments = null, rest = "";
  const take = (line) => {
    const told = JSON.parse(line);
    if (told.error) throw new Error(told.error);
    if (told.model) { ({ moments } = told); return; }
    compared.t.push(...told.t);
    compared.steering.push(...told.steering);
    sayAgreement(told, moments);
    const now = performance.now();
    if (!told.done && now - compared.drawn < 300) return;
    compared.drawn = now;
    growCurves();
    drawFrame(sides[0]);
  };
  try {
    say($("against-says"), "the server is computing it …");
    const response = await request(pathOf(name, `/compared/${index}`), { signal: stop.signal });
    const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
    for (let piece = await reader.read(); !piece.done; piece = await reader.read()) {
      if (compared.stop !== stop) return;
      const lines = (rest + piece.value).split("\n");
      rest = lines.pop();
      lines.forEach(take);
    }
  } catch (error) {
    if (compared.stop === stop) say($("against-says"), error.message);
  }
}
$("against").addEventListener("change", () => { compareWith($("against").value); seek(player.index); });
