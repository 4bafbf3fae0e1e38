// -- plots against time, and the path: drawn once, then only their cursors move ----------------------------------------

const LEFT = 46; // of the plots' frames [px]
const RIGHT = 6;
const TALL = 86;

// A series is { name, colour, values(row), now(state), dash }: what it is at a row, and at an interpolated state.
const series = (name, colour, column, dash, scale = 1, offset = 0) => ({
  name, colour, dash, scale,
  values: (row) => (at(row, column) - offset) * scale,
  now: (state) => (state[column] - offset) * scale,
});

function bodyPanels(body) {
  const of = (name) => COLUMN[`${name}_${body}`];
  return [
    { title: "position", unit: "m", series: [series("x", body, of("x")), series("y", body, of("y"), true)] },
    { title: "angle", unit: "rad", series: [series("\u03b8", body, of("theta"))] },
    { title: "velocity", unit: "m/s", series: [series("vx", body, of("vx")), series("vy", body, of("vy"), true)] },
    { title: "angular velocity", unit: "rad/s", series: [series("\u03c9", body, of("omega"))] },
  ];
}

function mostOf(column, offset = 0) {
  let found = 0;
  for (let row = 0; row < COUNT; row++) found = Math.max(found, Math.abs(at(row, column) - offset));
  return found;
}

function energyPanels() {
  const before = at(0, COLUMN.energy);
  const joule = unitFor(Math.max(mostOf(COLUMN.energy, before), mostOf(COLUMN.work)), "J");
  const gained = series("energy gained", "energy", COLUMN.energy, false, 1 / joule.value, before);
  const work = series("work of the torque", "ink", COLUMN.work, true, 1 / joule.value);
  gained.wide = 5;
  const left = (state) => state[COLUMN.energy] - before - state[COLUMN.work];
  const text = (state) => `gained \u2212 work ${general(left(state), 2)} J`;
  return [{ title: "energy", unit: joule.symbol, tall: 150, series: [gained, work], extra: text }];
}

function torquePanels() {
  const unit = unitFor(mostOf(COLUMN.torque), "N m");
  const torque = series("on the box", "torque", COLUMN.torque, false, 1 / unit.value);
  torque.held = true;
  return [{ title: "torque", unit: unit.symbol, tall: 150, series: [torque] }];
}

function rangeOf(panel) {
  let low = Infinity;
  let high = -Infinity;
  for (const one of panel.series) {
    for (let row = 0; row < COUNT; row++) {
      const value = one.values(row);
      low = Math.min(low, value);
      high = Math.max(high, value);
    }
  }
  const visible = high - low > 1e-6 * Math.max(Math.abs(low), Math.abs(high)); // not only rounding
  const room = visible ? 0.06 * (high - low) : Math.abs(high) * 0.1 || 1;
  return [low - room, high + room];
}

function legendOf(panel) {
  const legend = make("div", "legend");
  legend.append(make("b", "", panel.title), make("span", "", `[${panel.unit}]`));
  panel.outputs = panel.series.map((one) => {
    const entry = make("span", "values");
    const stroke = make("i");
    stroke.style.borderTopStyle = one.dash ? "dashed" : "solid";
    stroke.style.borderTopColor = `var(--${one.colour})`;
    const output = make("output");
    entry.append(stroke, `${one.name} `, output);
    legend.append(entry);
    return output;
  });
  if (panel.extra) {
    const entry = make("span", "values");
    panel.extraOutput = entry;
    legend.append(entry);
  }
  return legend;
}

function drawFrame(pen, width, height, [low, high]) {
  const y = (value) => height - ((value - low) / (high - low)) * height;
  const step = roundStep((high - low) / Math.max(2, height / 21));
  const decimals = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  pen.font = "11px system-ui, sans-serif";
  pen.textAlign = "right";
  pen.textBaseline = "middle";
  pen.lineWidth = 1;
  const first = Math.ceil(low / step);
  for (let line = first; line * step <= high && line < first + 100; line++) {
    const place = Math.round(y(line * step)) + 0.5;
    pen.strokeStyle = line === 0 ? colours.soft : colours.line;
    pen.globalAlpha = line === 0 ? 0.55 : 1;
    pen.beginPath();
    pen.moveTo(LEFT, place);
    pen.lineTo(width - RIGHT, place);
    pen.stroke();
    pen.globalAlpha = 1;
    pen.fillStyle = colours.soft;
    pen.fillText(labelOf(line, step, decimals), LEFT - 6, Math.min(Math.max(place, 6), height - 6)); // none is cut
  }
  return y;
}

function labelOf(line, step, decimals) {
  if (line === 0) return "0";
  if (step < 1e5 && step >= 1e-4) return fixed(line * step, decimals);
  return (line * step).toExponential(0).replace(/-/g, MINUS);
}

function drawImpacts(pen, x, height) {
  pen.strokeStyle = colours.hit;
  pen.globalAlpha = impacts.length > 200 ? 0.12 : 0.38;
  pen.lineWidth = 1;
  pen.beginPath();
  for (const place of apart(impacts.map((hit) => x(hit.time)), 1)) {
    pen.moveTo(place, 0);
    pen.lineTo(place, height);
  }
  pen.stroke();
  pen.globalAlpha = 1;
}

function drawSeries(pen, one, x, y) {
  pen.strokeStyle = colours[one.colour];
  pen.lineWidth = one.wide || 1.6;
  pen.globalAlpha = one.wide ? 0.55 : 1;
  pen.setLineDash(one.dash ? [5, 3] : []);
  pen.lineJoin = "round";
  pen.beginPath();
  for (let row = 0; row < COUNT; row++) {
    const place = x(at(row, 0));
    const value = y(one.values(row));
    if (one.held && row > 0) pen.lineTo(x(at(row - 1, 0)), value);
    if (row === 0) pen.moveTo(place, value);
    else pen.lineTo(place, value);
  }
  pen.stroke();
  pen.setLineDash([]);
  pen.globalAlpha = 1;
}

function drawTimes(canvas) {
  const { pen, width } = sharpen(canvas);
  const inner = width - LEFT - RIGHT;
  const step = roundStep((LASTS || 1) / Math.max(2, inner / 60));
  const decimals = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  pen.font = "11px system-ui, sans-serif";
  pen.fillStyle = colours.soft;
  pen.textBaseline = "top";
  for (let line = Math.ceil(START / step - 1e-9); line * step <= END + 1e-9 * step; line++) {
    const place = LEFT + (inner * (line * step - START)) / (LASTS || 1);
    const last = place > width - RIGHT - 12;
    pen.textAlign = last ? "right" : "center";
    pen.fillText((line === 0 ? "0" : fixed(line * step, decimals)) + (last ? " s" : ""), last ? width - 1 : place, 4);
  }
}

// Plots one above the other over one axis of time.
function makePlots(container, panels, seek) {
  for (const panel of panels) {
    panel.range = rangeOf(panel);
    panel.canvas = make("canvas");
    panel.canvas.style.height = `${panel.tall || TALL}px`;
    container.append(legendOf(panel), panel.canvas);
  }
  const times = make("canvas");
  times.style.height = "20px";
  const cursor = make("div", "cursor");
  container.append(times, cursor);
  let inner = 1;
  const x = (time) => LEFT + (inner * (time - START)) / (LASTS || 1);

  function resize() {
    for (const panel of panels) {
      const { pen, width, height } = sharpen(panel.canvas);
      inner = width - LEFT - RIGHT;
      const y = drawFrame(pen, width, height, panel.range);
      drawImpacts(pen, x, height);
      panel.series.forEach((one) => drawSeries(pen, one, x, y));
    }
    drawTimes(times);
    cursor.style.top = `${panels[0].canvas.offsetTop}px`;
    cursor.style.height = `${times.offsetTop - panels[0].canvas.offsetTop}px`;
  }
  function show(state, numbers) {
    cursor.style.transform = `translateX(${x(state[0])}px)`;
    if (!numbers) return;
    for (const panel of panels) {
      panel.series.forEach((one, number) => (panel.outputs[number].textContent = general(one.now(state), 4)));
      if (panel.extra) panel.extraOutput.textContent = panel.extra(state);
    }
  }
  dragged(container, seek, (event, box) => {
    const share = (event.clientX - box.left - LEFT) / inner;
    return START + LASTS * Math.min(1, Math.max(0, share));
  });
  resize();
  return { resize, show };
}

// A click or a drag in an element seeks the time that `timeOf` finds under the pointer.
function dragged(element, seek, timeOf) {
  const go = (event) => seek(timeOf(event, element.getBoundingClientRect()));
  element.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    element.setPointerCapture(event.pointerId);
    seek.begin();
    go(event);
  });
  element.addEventListener("pointermove", (event) => element.hasPointerCapture(event.pointerId) && go(event));
  for (const end of ["pointerup", "pointercancel"]) element.addEventListener(end, () => seek.end());
}

// The ways of both centres in the plane, at one scale for x and y.
function makePath(seek) {
  const element = byId("path");
  const canvas = element.querySelector("canvas");
  const bodies = ["box", "jack"].map((body) => {
    const dot = make("i");
    dot.style.background = `var(--${body})`;
    element.append(dot);
    return { body, dot, x: COLUMN[`x_${body}`], y: COLUMN[`y_${body}`], output: make("output") };
  });
  for (const { body, output } of bodies) {
    const entry = make("span", "values");
    const stroke = make("i");
    stroke.style.borderTopColor = `var(--${body})`;
    entry.append(stroke, `${body} (x, y) `, output, " m");
    byId("path-legend").append(entry);
  }
  let scale, middle, half;
  const px = (x) => half[0] + (x - middle[0]) * scale;
  const py = (y) => half[1] - (y - middle[1]) * scale;

  function resize() {
    const { pen, width, height } = sharpen(canvas);
    ({ scale, middle, half } = fitted(bodies, width, height));
    drawGrid(pen, width, height, px, py, scale);
    for (const { body, x, y } of bodies) {
      pen.strokeStyle = colours[body];
      pen.lineWidth = body === "box" ? 2.5 : 1.5;
      pen.lineJoin = "round";
      pen.beginPath();
      for (let row = 0; row < COUNT; row++) pen.lineTo(px(at(row, x)), py(at(row, y)));
      pen.stroke();
    }
    const state = new Float64Array(WIDTH);
    pen.fillStyle = colours.hit;
    for (const hit of impacts) {
      sampleAt(hit.time, state);
      pen.beginPath();
      pen.arc(px(state[COLUMN.x_jack]), py(state[COLUMN.y_jack]), impacts.length > 200 ? 1.4 : 2.6, 0, 2 * Math.PI);
      pen.fill();
    }
  }
  function show(state, numbers) {
    for (const { dot, x, y, output } of bodies) {
      dot.style.transform = `translate(${px(state[x])}px, ${py(state[y])}px)`;
      if (numbers) output.textContent = `${fixed(state[x], 2)}, ${fixed(state[y], 2)}`;
    }
  }
  dragged(element, seek, (event, box) => {
    const [x, y] = [event.clientX - box.left, event.clientY - box.top];
    let best = [Infinity, START];
    for (let row = 0; row < COUNT; row++) {
      const away = Math.hypot(px(at(row, COLUMN.x_jack)) - x, py(at(row, COLUMN.y_jack)) - y);
      if (away < best[0]) best = [away, at(row, 0)];
    }
    return best[1];
  });
  resize();
  return { resize, show };
}

function fitted(bodies, width, height) {
  const ends = [[Infinity, -Infinity], [Infinity, -Infinity]];
  for (let row = 0; row < COUNT; row++) {
    for (const one of bodies) {
      [one.x, one.y].forEach((column, axis) => {
        ends[axis] = [Math.min(ends[axis][0], at(row, column)), Math.max(ends[axis][1], at(row, column))];
      });
    }
  }
  const sizes = ends.map(([low, high]) => Math.max(high - low, 0.1 * data.halfWidth) * 1.1);
  const scale = Math.min((width - LEFT) / sizes[0], (height - 22) / sizes[1]);
  return {
    scale,
    middle: ends.map(([low, high]) => (low + high) / 2),
    half: [LEFT + (width - LEFT) / 2, (height - 22) / 2],
  };
}

function drawGrid(pen, width, height, px, py, scale) {
  const step = roundStep(44 / scale);
  const decimals = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  pen.font = "11px system-ui, sans-serif";
  pen.fillStyle = colours.soft;
  pen.strokeStyle = colours.line;
  pen.lineWidth = 1;
  const lines = (from, to) => {
    const found = [];
    for (let line = Math.ceil(from / step); line * step <= to && found.length < 200; line++) found.push(line * step);
    return found;
  };
  const inverse = (place, map) => (place - map(0)) / (map(1) - map(0));
  pen.beginPath();
  pen.textAlign = "center";
  pen.textBaseline = "bottom";
  for (const value of lines(inverse(LEFT, px), inverse(width, px))) {
    pen.moveTo(px(value), 0);
    pen.lineTo(px(value), height - 22);
    if (px(value) < width - 14) pen.fillText(value === 0 ? "0" : fixed(value, decimals), px(value), height - 4);
  }
  pen.textAlign = "right";
  pen.textBaseline = "middle";
  for (const value of lines(inverse(height - 22, py), inverse(0, py))) {
    pen.moveTo(LEFT, py(value));
    pen.lineTo(width, py(value));
    if (py(value) > 7) pen.fillText(value === 0 ? "0" : fixed(value, decimals), LEFT - 6, py(value));
  }
  pen.stroke();
}
