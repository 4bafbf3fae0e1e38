// -- what all drawings share: colours, sharp canvases, numbers with units ---------------------------------------------

const byId = (id) => document.getElementById(id);
const make = (tag, name, text) => {
  const element = document.createElement(tag);
  if (name) element.className = name;
  if (text !== undefined) element.textContent = text;
  return element;
};

let colours = {};
function readColours() {
  const style = getComputedStyle(document.documentElement);
  const names = "paper card ink soft line rule box jack foot torque energy hit inside around".split(" ");
  colours = Object.fromEntries(names.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
}

// A canvas as large as its place, in device pixels; drawing counts in CSS pixels.
function sharpen(canvas) {
  const { width, height } = canvas.getBoundingClientRect();
  const ratio = Math.min(window.devicePixelRatio || 1, 2);
  canvas.width = Math.max(1, Math.round(width * ratio));
  canvas.height = Math.max(1, Math.round(height * ratio));
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  return { pen, width, height };
}

const MINUS = "\u2212";
function fixed(value, decimals) {
  const text = value.toFixed(decimals);
  return (Number(text) === 0 ? text.replace("-", "") : text).replace("-", MINUS);
}
function general(value, digits) {
  const size = Math.abs(value);
  if (size !== 0 && (size < 1e-3 || size >= 1e6)) return value.toExponential(digits - 1).replace(/-/g, MINUS);
  return fixed(value, Math.max(0, digits - 1 - (size >= 1 ? Math.floor(Math.log10(size)) : 0)));
}

// Of rising places those that are at least so far from the one before: of a foot at rest there are many.
function apart(places, least) {
  let last = -Infinity;
  return places.filter((place) => {
    if (place - last < least) return false;
    last = place;
    return true;
  });
}

// A unit for numbers up to `most`: its value and its symbol.
function unitFor(most, symbol) {
  const prefixes = [[1e9, "G"], [1e6, "M"], [1e3, "k"], [1, ""], [1e-3, "m"], [1e-6, "\u00b5"]];
  const found = prefixes.find(([value]) => most >= value) || [1, ""];
  return { value: found[0], symbol: found[1] + symbol };
}

// The smallest of 1, 2, 5 times a power of ten that is at least `least`.
function roundStep(least) {
  const power = 10 ** Math.floor(Math.log10(least));
  return [1, 2, 5, 10].map((factor) => factor * power).find((step) => step >= 0.999 * least);
}

const secondsDigits = Math.min(6, Math.max(2, Math.ceil(-Math.log10(Math.max(LASTS, 1e-9) / 500))));
