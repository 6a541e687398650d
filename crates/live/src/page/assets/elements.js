"use strict";
// What the page's parts share: elements by name, colours of the system's light or dark, numbers in words.
const $ = (id) => document.getElementById(id);
const dark = matchMedia("(prefers-color-scheme: dark)");
const colours = {};

function readColours() {
  const style = getComputedStyle(document.documentElement);
  for (const name of ["paper", "card", "ink", "faint", "line", "a", "b", "c", "good", "bad", "road"]) {
    colours[name] = style.getPropertyValue("--" + name).trim();
  }
}
readColours();
dark.addEventListener("change", readColours);

const known = (value) => value !== null && value !== undefined;
const fixed = (value, digits, unit = "") => (known(value) ? value.toFixed(digits) + unit : "–");

// Text that is written only where it changes: the browser lays out again at every write.
function say(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

// A canvas with as many pixels as the screen has for it; returns its context in CSS pixels, and its size.
function sharp(canvas) {
  const { clientWidth: width, clientHeight: height } = canvas, ratio = devicePixelRatio || 1;
  const [w, h] = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  return { context, width, height };
}
