// -- the animation: the camera follows the box's centre, ruled lines stand still in the world -------------------------

const TRAIL = 2.6 * data.timeScale; // [s]
const FOOT_TRAIL = 0.9 * data.timeScale; // [s]
const FLASH = 0.7 * data.timeScale; // [s]

function makeStage() {
  const element = byId("stage");
  const canvas = element.querySelector("canvas");
  let pen, width, height, scale;
  const state = new Float64Array(WIDTH);
  const passed = new Float64Array(WIDTH);

  function resize() {
    ({ pen, width, height } = sharpen(canvas));
    scale = Math.min(width, height) / (2 * Math.SQRT2 * data.halfWidth * 1.09);
  }
  const sx = (x) => width / 2 + (x - state[COLUMN.x_box]) * scale;
  const sy = (y) => height / 2 - (y - state[COLUMN.y_box]) * scale;

  // `ghost`: the 12 numbers of another motion, drawn pale about its own box's centre.
  function draw(time, ghost = null) {
    sampleAt(time, state);
    pen.clearRect(0, 0, width, height);
    drawInside();
    drawRules();
    if (ghost) drawGhost(ghost);
    drawWalls();
    drawTrail(time, FOOT_TRAIL, 1.6, colours.foot, (one) => footOf(one, 0));
    drawTrail(time, TRAIL, 2.6, colours.jack, () => [0, 0]);
    drawFlashes(time);
    drawJack();
  }

  function inBoxFrame(draws) {
    pen.save();
    pen.translate(width / 2, height / 2);
    pen.rotate(-state[COLUMN.theta_box]);
    draws();
    pen.restore();
  }

  function drawInside() {
    const half = data.halfWidth * scale;
    inBoxFrame(() => {
      pen.fillStyle = colours.inside;
      pen.fillRect(-half, -half, 2 * half, 2 * half);
    });
  }

  function drawGhost(ghost) {
    const own = state.slice();
    state.set(ghost, 1);
    pen.globalAlpha = 0.3;
    drawWalls(false);
    drawJack();
    pen.globalAlpha = 1;
    state.set(own);
  }

  function drawWalls(named = true) {
    const half = data.halfWidth * scale;
    const wall = Math.max(5, 0.03 * half);
    inBoxFrame(() => {
      pen.strokeStyle = colours.box;
      pen.lineWidth = wall;
      pen.lineJoin = "round";
      pen.strokeRect(-half - wall / 2, -half - wall / 2, 2 * half + wall, 2 * half + wall);
      if (named) drawWallNames(half + wall);
    });
  }

  function drawWallNames(distance) {
    pen.fillStyle = colours.soft;
    pen.font = `${Math.max(10, Math.min(12.5, 0.06 * distance))}px system-ui, sans-serif`;
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    [0, 1, 2, 3].forEach((wall) => {
      pen.save();
      pen.rotate((-wall * Math.PI) / 2);
      pen.translate(distance + 11, 0);
      const turned = (1 - wall) * (Math.PI / 2) - state[COLUMN.theta_box]; // of the text, which never stands on its head
      pen.rotate(Math.cos(turned) < 0 ? -Math.PI / 2 : Math.PI / 2);
      pen.fillText(`wall ${wall}`, 0, 0);
      pen.restore();
    });
  }

  function drawRules() {
    const spacing = roundStep(data.halfWidth / 3.5);
    pen.strokeStyle = colours.rule;
    pen.lineWidth = 1;
    pen.beginPath();
    for (const [column, size, horizontal] of [[COLUMN.x_box, width, false], [COLUMN.y_box, height, true]]) {
      const reach = size / 2 / scale;
      const first = Math.ceil((state[column] - reach) / spacing);
      for (let line = first; line * spacing <= state[column] + reach && line < first + 100; line++) {
        const place = Math.round(horizontal ? sy(line * spacing) : sx(line * spacing)) + 0.5;
        pen.moveTo(horizontal ? 0 : place, horizontal ? place : 0);
        pen.lineTo(horizontal ? width : place, horizontal ? place : height);
      }
    }
    pen.stroke();
  }

  // The way through the world of a point of the jack: through every sample, so through the corner at each impact.
  function pointsOf(time, lasts, offset) {
    const from = Math.max(START, time - lasts);
    const times = [from];
    for (let row = rowAt(from) + 1; row < COUNT && at(row, 0) < time; row++) {
      const last = times[times.length - 1];
      const parts = Math.min(16, Math.ceil((at(row, 0) - last) / (0.01 * data.timeScale)));
      for (let part = 1; part <= parts; part++) times.push(last + ((at(row, 0) - last) * part) / parts);
    }
    times.push(time);
    return times.map((one) => {
      sampleAt(one, passed);
      const [ox, oy] = offset(passed);
      return [sx(passed[COLUMN.x_jack] + ox), sy(passed[COLUMN.y_jack] + oy), one];
    });
  }

  function drawTrail(time, lasts, thick, colour, offset) {
    const points = pointsOf(time, lasts, offset);
    const shades = 20;
    pen.strokeStyle = colour;
    pen.lineWidth = thick;
    pen.lineJoin = "round";
    pen.lineCap = "butt"; // round ends would overlap, and show as beads
    let first = 0;
    for (let shade = 1; shade <= shades; shade++) {
      const until = time - lasts * (1 - shade / shades);
      pen.globalAlpha = 0.85 * (shade / shades) ** 1.5;
      pen.beginPath();
      pen.moveTo(points[first][0], points[first][1]);
      let next = first;
      while (next + 1 < points.length && (points[next + 1][2] <= until || shade === shades)) {
        next++;
        pen.lineTo(points[next][0], points[next][1]);
      }
      if (next > first) pen.stroke();
      first = next;
    }
    pen.globalAlpha = 1;
  }

  function drawFlashes(time) {
    const shown = new Array(16).fill(Infinity); // when a wall and a foot flashed that are drawn already [s]
    for (let number = impactsBy(time) - 1; number >= 0 && time - impacts[number].time < FLASH; number--) {
      const hit = impacts[number];
      const pair = 4 * hit.wall + hit.foot;
      if (shown[pair] - hit.time < FLASH / 8) continue; // of a foot at rest
      shown[pair] = hit.time;
      const age = (time - hit.time) / FLASH;
      const strength = Math.min(1, hit.impulse / data.knock);
      inBoxFrame(() => {
        pen.strokeStyle = pen.fillStyle = colours.hit;
        pen.globalAlpha = 1 - age;
        pen.lineWidth = 2.5;
        pen.beginPath();
        pen.arc(hit.x * scale, -hit.y * scale, 5 + (10 + 22 * strength) * Math.sqrt(age), 0, 2 * Math.PI);
        pen.stroke();
        pen.globalAlpha = 0.6 * (1 - age) ** 2;
        pen.beginPath();
        pen.arc(hit.x * scale, -hit.y * scale, 5 + 6 * strength, 0, 2 * Math.PI);
        pen.fill();
      });
    }
    pen.globalAlpha = 1;
  }

  function drawJack() {
    const x = sx(state[COLUMN.x_jack]);
    const y = sy(state[COLUMN.y_jack]);
    const arm = data.arm * scale;
    const radius = Math.min(8, Math.max(2, 0.19 * arm));
    pen.strokeStyle = colours.jack;
    pen.lineWidth = Math.max(2, 0.85 * radius);
    pen.lineCap = "round";
    pen.beginPath();
    const feet = [0, 1, 2, 3].map((foot) => footOf(state, foot).map((part) => part * scale));
    for (const [ox, oy] of feet) {
      pen.moveTo(x, y);
      pen.lineTo(x + ox, y - oy);
    }
    pen.stroke();
    feet.forEach(([ox, oy], foot) => {
      pen.fillStyle = foot === 0 ? colours.foot : colours.box;
      pen.strokeStyle = colours.inside;
      pen.lineWidth = 1.5;
      pen.beginPath();
      pen.arc(x + ox, y - oy, foot === 0 ? 1.3 * radius : radius, 0, 2 * Math.PI);
      pen.fill();
      pen.stroke();
    });
  }

  resize();
  return { resize, draw, state };
}
