const { readFileSync, writeFileSync } = require("fs"), { cos, sin, PI } = Math;
const contact = ({ box_half_width: L, jack_arm: l }, q, [wall, foot]) => {
  const [a, b] = [q[2] + (wall * PI) / 2, q[5] + (foot * PI) / 2];
  const n = [cos(a), sin(a)], o = [l * cos(b), l * sin(b)];
  const p = [q[3] - q[0] + o[0], q[4] - q[1] + o[1]];
  const slope = [n[0], n[1], n[1] * p[0] - n[0] * p[1], -n[0], -n[1], n[0] * o[1] - n[1] * o[0]];
  const rate = slope.reduce((sum, j, i) => sum + j * q[6 + i], 0);
  return { gap: L - n[0] * p[0] - n[1] * p[1], slope, rate };
};
const fly = (q, a, t) =>
  q.map((x, i) => (i < 6 ? x + (q[i + 6] + (a[i] * t) / 2) * t : x + a[i - 6] * t));
const bounce = (scene, q, { slope, rate }) => {
  const { box_mass: m, jack_mass: j } = scene;
  const masses = [m, m, scene.box_inertia, j, j, scene.jack_inertia];
  const lightness = slope.reduce((sum, s, i) => sum + (s * s) / masses[i], 0);
  const push = (-(1 + scene.restitution) * rate) / lightness;
  return q.map((x, i) => (i < 6 ? x : x + (slope[i - 6] * push) / masses[i - 6]));
};
const pairs = [...Array(16).keys()].map((n) => [n >> 2, n % 4]), hits = ["case,time,wall,foot"];
const { state, cases } = JSON.parse(readFileSync("cases.json"));
const rows = [["case", "time", ...state].join()];
for (const { name, scene, start, torque, dt, duration } of cases) {
  if (torque.kind === "chirp") continue;
  for (let step = 0, q = start; step < Math.round(duration / dt); step++) {
    const a = [0, 0, (torque.values?.[step] ?? 0) / scene.box_inertia, 0, -scene.gravity, 0];
    const isIn = ({ gap, rate }) => gap < 0 && rate < 0;
    const inside = (t) => pairs.find((pair) => isIn(contact(scene, fly(q, a, t), pair)));
    for (let left = dt; left > 0; ) {
      let low = 0, high = Math.min(left, 1e-3), pair = inside(high);
      for (let n = 0; pair && n < 45; n++) {
        const middle = (low + high) / 2;
        inside(middle) ? (high = middle) : (low = middle);
      }
      q = fly(q, a, high), left -= high; // to just after the impact, or on by 1 ms
      if (!pair) continue;
      pair = inside(0), q = bounce(scene, q, contact(scene, q, pair));
      hits.push([name, (step + 1) * dt - left, ...pair].join());
    }
    rows.push([name, (step + 1) * dt, ...q].join());
  }
}
writeFileSync("states.csv", rows.join("\n")), writeFileSync("impacts.csv", hits.join("\n"));
