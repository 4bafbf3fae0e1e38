// Plays the cases of docs/reference with an engine in JavaScript, and writes what scripts/referee.py reads:
//   node matter.js '{"substeps": 16}' FOLDER && python scripts/referee.py FOLDER/states.csv --impacts FOLDER/impacts.csv
// The first argument has the substeps of a control step, the engine's settings (the best are in docs/accuracy.md) and, if
// not all, the "cases". With "seconds" it plays on for as long and prints simulated seconds per second of the processor.
// An adapter makes a scene: step(torque) plays a substep and returns the contacts that pushed, as 4 wall + foot; state()
// returns the 12 numbers. A contact counts from its substep's start, or from its end if the adapter is `late`.
const { readFileSync, writeFileSync } = require("fs"), { join } = require("path"), { round, abs, sin, cos, PI } = Math;

const torqueAt = ({ kind, values, amplitude, start_frequency: start, rate }, step, t) =>
  kind === "held" ? values[step] : kind === "chirp" ? amplitude * sin(2 * PI * t * (start + (rate * t) / 2)) : 0;
const meanTorque = (torque, step, t, h) => // by Simpson's rule
  [1, 4, 1].reduce((sum, weight, n) => sum + weight * torqueAt(torque, step, t + (n * h) / 2), 0) / 6;

function play(make, { name, scene, start, torque, dt, duration }, settings, rows, hits) {
  const { inner = 1 } = settings, steps = settings.substeps / inner, h = dt / steps; // some have substeps of their own
  const world = make(scene, start, h, settings), since = process.cpuUsage();
  let under = new Set(); // contacts under way: pushes in consecutive substeps are one impact
  rows?.push([name, 0, ...start].join());
  for (let step = 0; step < round(duration / dt); step++) {
    for (let number = 0; number < steps; number++) {
      const time = step * dt + number * h, pushed = new Set(world.step(meanTorque(torque, step, time, h)));
      for (const pair of pushed) {
        if (!under.has(pair)) hits?.push([name, time + (make.late ? h : 0), pair >> 2, pair % 4].join());
      }
      under = pushed;
    }
    const state = world.state();
    if (!state.every((number) => abs(number) < 1e9)) break; // the jack is lost
    rows?.push([name, (step + 1) * dt, ...state].join());
  }
  const { user, system } = process.cpuUsage(since);
  world.free?.();
  return (user + system) / 1e6; // [s]
}

exports.main = (make) => {
  const settings = { substeps: 16, ...JSON.parse(process.argv[2] ?? "{}") }, folder = process.argv[3] ?? ".";
  const { state, cases } = JSON.parse(readFileSync(join(__dirname, "../../../docs/reference/cases.json")));
  const rows = [["case", "time", ...state].join()], hits = ["case,time,wall,foot"];
  const chosen = cases.filter(({ name }) => settings.cases?.includes(name) ?? true);
  for (const one of chosen) play(make, one, settings, rows, hits);
  writeFileSync(join(folder, "states.csv"), rows.join("\n") + "\n");
  writeFileSync(join(folder, "impacts.csv"), hits.join("\n") + "\n");
  const speed = () => {
    let simulated = 0, used = 0;
    while (used < settings.seconds) {
      for (const one of chosen) simulated += one.duration, used += play(make, one, settings);
    }
    return simulated / used;
  };
  console.log(JSON.stringify({ speed: settings.seconds ? [speed(), speed()][1] : null })); // the first warms up
};
exports.directions = [0, 1, 2, 3].map((n) => [round(cos((n * PI) / 2)), round(sin((n * PI) / 2))]);
