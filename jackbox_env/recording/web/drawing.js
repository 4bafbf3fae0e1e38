// -- what all drawings share: the data, colours, sharp canvases, numbers with units -----------------------------------

const byId = (id) => document.getElementById(id);
const make = (tag, name, text) => {
  const element = document.createElement(tag);
  if (name) element.className = name;
  if (text !== undefined) element.textContent = text;
  return element;
};

const data = JSON.parse(byId("data").textContent);
const WIDTH = data.columns.length;
const COLUMN = Object.fromEntries(data.columns.map((name, number) => [name, number]));
const unpacked = (packed, Kind) => {
  const text = atob(packed);
  const bytes = new Uint8Array(text.length);
  for (let place = 0; place < text.length; place++) bytes[place] = text.charCodeAt(place);
  return new Kind(bytes.buffer);
};

// The last row at or before a time: just after an impact at that very time.
function rowAt(time) {
  let low = 0;
  let high = COUNT;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (at(middle, 0) <= time) low = middle;
    else high = middle;
  }
  return low;
}

// Number of impacts at or before a time.
function impactsBy(time) {
  let low = 0;
  let high = impacts.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (impacts[middle].time <= time) low = middle + 1;
    else high = middle;
  }
  return low;
}

// Where a foot is: [x, y] from the jack's centre; and where that is on the box's own axes.
function footOf(state, foot) {
  const angle = state[COLUMN.theta_jack] + (foot * Math.PI) / 2;
  return [data.arm * Math.cos(angle), data.arm * Math.sin(angle)];
}
function placeOf(state, foot) {
  const [ox, oy] = footOf(state, foot);
  const [x, y] = [state[COLUMN.x_jack] - state[COLUMN.x_box] + ox, state[COLUMN.y_jack] - state[COLUMN.y_box] + oy];
  const [cosine, sine] = [Math.cos(state[COLUMN.theta_box]), Math.sin(state[COLUMN.theta_box])];
  return { x: cosine * x + sine * y, y: cosine * y - sine * x };
}

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
