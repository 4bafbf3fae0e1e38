// -- a game: its steps, what the drawings read of them, and its text --------------------------------------------------

const SCORED = 500; // steps that count for the return
const FLASHES = 8; // impacts of a step that are drawn, at most
const BASIS = 0xcbf29ce484222325n; // of the digest, FNV-1a
const PRIME = 0x100000001b3n;

const physics = await loadPhysics(unpacked(data.module, Uint8Array), data);
const [desk, sketch] = [physics.makeDesk(), physics.makeDesk()]; // of whole steps, and of moments within a step
const agents = Object.fromEntries(
  Object.entries(data.tasks).map(([task, { agent }]) => {
    const weights = Float32Array.from(unpacked(agent.weights, Int16Array), (weight) => weight * agent.scale);
    return [task, desk.agent({ ...agent, weights })];
  }),
);
const game = {}; // `begin` fills it in
const at = (row, column) => rows[row][column];

function valuesOf(fields) {
  const values = data.values.slice();
  for (const [name, value] of Object.entries(fields)) values[data.fields[name].index] = value;
  return values;
}

// The numbers at a time, into `into`: a part of the present step, or a row of the past.
function sampleAt(time, into) {
  const { open } = game;
  into.set(rows[rowAt(time)]);
  if (open && time > open.time && into[0] !== time) {
    sketch.step(open.state, open.time, Math.min(time - open.time, game.dt), open.torque);
    into.set(sketch.after, 1);
    into[COLUMN.torque] = sketch.number("MEAN_TORQUE");
  }
  into[0] = time;
  return into;
}

function begin(task, fields, dt, start, recorded = null) {
  for (const one of [desk, sketch]) one.setScene(valuesOf(fields));
  data.arm = desk.scene[data.fields.jack_arm.index];
  data.knock = 2 * desk.scene[data.fields.jack_mass.index] * data.speedScale; // the impulse of a hard impact [N s]
  const state = typeof start[0] === "string" ? desk.start(start.map(BigInt)) : Float64Array.from(start, (number) => number + 0); // no -0, which JSON does not keep
  for (const one of [desk, sketch]) one.place(state, dt, task);
  Object.assign(game, {
    task, fields, dt, start, recorded, state, time: 0, open: null, lost: false, acted: false, assisted: false,
    differs: 0, shares: [], checks: [], digest: BASIS, sum: 0, scored: 0, hits: 0, energy: sketch.number("ENERGY"),
  });
  agents[task].restart();
  const row = new Float64Array(WIDTH);
  row.set(state, 1);
  [rows, impacts, COUNT] = [[row], [], 1];
}

// Begin a step under a share of the torque limit, or under the chirp (null).
function openStep(share) {
  const torque = share === null ? null : share * desk.scene[data.limit];
  game.lost = !desk.step(game.state, game.time, game.dt, torque);
  if (game.lost) return;
  const [next, count, hits] = [desk.after.slice(), desk.number("HITS"), desk.impacts(FLASHES)];
  game.open = { time: game.time, state: game.state, next, share, torque, count, reward: desk.reward(game.task) };
  const moments = [0.25, 0.5, 0.75, 1].map((part) => ({ since: part * game.dt }));
  let [last, impulse] = [0, 0]; // the impulse of the torque since then [N m s]
  for (const moment of [...moments, ...hits].sort((a, b) => a.since - b.since)) {
    const { since, wall, foot } = moment;
    const row = rows[COUNT - 1].slice();
    if (since > last) {
      sketch.step(game.state, game.time, since, torque);
      sketch.reward(game.task);
      row.set(sketch.after, 1);
      row[0] = game.time + since;
      row[COLUMN.torque] = (sketch.number("MEAN_TORQUE") * since - impulse) / (since - last);
      row[COLUMN.energy] = sketch.number("ENERGY") - game.energy;
      row[COLUMN.work] += row[COLUMN.torque] * (row[COLUMN.theta_box] - at(COUNT - 1, COLUMN.theta_box));
      [last, impulse, COUNT] = [since, sketch.number("MEAN_TORQUE") * since, rows.push(row)];
    }
    if (foot !== undefined) impacts.push({ time: row[0], wall, foot, impulse: moment.impulse, ...placeOf(row, foot) });
  }
}

function closeStep() {
  const { next, share, count, reward } = game.open;
  for (const word of new BigUint64Array(next.buffer)) game.digest = BigInt.asUintN(64, (game.digest ^ word) * PRIME);
  game.checks.push(Number(game.digest >> 56n));
  const made = game.shares.push(share);
  if (game.recorded && game.recorded.checks[made - 1] !== game.checks[made - 1]) game.differs ||= made;
  game.sum += reward;
  if (made <= SCORED) game.scored = game.sum;
  [game.state, game.time, game.open] = [next, game.time + game.dt, null];
  game.hits += count;
  START = Math.max(0, game.time - KEPT);
  END = START + KEPT;
  if (at(0, 0) >= START - 1) return;
  rows = rows.filter((row) => row[0] >= START);
  impacts = impacts.filter((hit) => hit.time >= START);
  COUNT = rows.length;
}

// -- its text: JSON, described in jackbox_env/recording/game.py --------------------------------------------------------

function packed(array) {
  const letters = Array.from(new Uint8Array(array.buffer), (byte) => String.fromCharCode(byte));
  return btoa(letters.join("")).replace(/\+/g, "-").replace(/\//g, "_").replace(/=/g, "");
}

function writeGame() {
  const [shares, counts] = [[], []];
  game.shares.forEach((share, step) => {
    const goes = step && Object.is(share, game.shares[step - 1]) && (counts.at(-1) & 0x7fff) < 0x7fff;
    if (goes) counts[counts.length - 1]++;
    else [shares[shares.length], counts[counts.length]] = [share ?? 0, share === null ? 0x8001 : 1];
  });
  const { task, fields: scene, dt, start } = game;
  const steps = {
    shares: packed(Float64Array.from(shares)), counts: packed(Uint16Array.from(counts)),
    checks: packed(Uint8Array.from(game.checks)), digest: game.digest.toString(16).padStart(16, "0"),
  };
  return JSON.stringify({ version: data.version, package: data.package, task, scene, dt, start, ...(shares.length ? steps : {}) });
}

class Refused extends Error {}
const must = (condition, sentence) => {
  if (!condition) throw new Refused(sentence);
};

// The arguments of `begin` from a text, or from a link that ends in one.
function readGame(link) {
  let [text, values] = [link.slice(link.indexOf("#") + 1)];
  try {
    text = decodeURIComponent(text);
    values = text.length <= data.mostText && JSON.parse(text);
  } catch {
    must(false, "the text is no whole game: it is cut off or damaged");
  }
  must(text.length <= data.mostText, `a game must have at most ${data.mostText} characters, got ${text.length}`);
  must(values?.constructor === Object, "a game must be a JSON object");
  const { version, package: _, task = "juggle", scene = {}, dt = 0.02, start, shares, counts, checks, digest, ...rest } = values;
  const [unknown] = Object.keys(rest);
  must(version === data.version, `a game's version must be ${data.version}, which this page reads, got ${JSON.stringify(version)}`);
  must(unknown === undefined, `a game has no ${unknown}`);
  must(Object.hasOwn(data.tasks, task), `task must be one of ${Object.keys(data.tasks).join(", ")}, got ${JSON.stringify(task)}`);
  must(dt > 0 && dt <= 1, `dt must be above 0 and at most 1 s, got ${JSON.stringify(dt)}`);
  must(scene?.constructor === Object, `scene must be an object of fields, got ${JSON.stringify(scene)}`);
  for (const [name, value] of Object.entries(scene)) {
    must(Object.hasOwn(data.fields, name), `a game's scene has ${Object.keys(data.fields).join(", ")}, got ${name}`);
    checkField(value, data.fields[name]);
  }
  checkStart(start, scene);
  const parts = [shares, counts, checks, digest];
  return [task, scene, dt, start, parts.some((part) => part !== undefined) ? readSteps(...parts) : null];
}

function checkField(value, { low, high, below, above }) {
  must(typeof value === "number" && value >= low, below.replace("{}", JSON.stringify(value)));
  must(value <= high, above.replace("{}", value));
}

function checkStart(start, scene) {
  const [numbers, words] = ["number", "string"].map((kind) => Array.isArray(start) && start.every((one) => typeof one === kind));
  const drawn = words && start.length === 4 && start.every((word) => /^\d{1,20}$/.test(word) && BigInt(word) < 1n << 64n);
  const listed = numbers && start.length === 12 && start.every((one) => Math.abs(one) < 1e9);
  must(listed || (drawn && BigInt(start[3]) & 1n), "start must be 12 numbers within +-1e9, or the 4 words of a generator");
  sketch.setScene(valuesOf(scene));
  const [inertia, outside] = [sketch.scene[data.inertia.index], drawn ? 0 : -sketch.gap(start)];
  sketch.setScene(desk.scene);
  checkField(inertia, data.inertia);
  must(outside <= data.startTolerance, `a start must have every foot inside the box, got a foot ${outside} m outside`);
}

function readSteps(...parts) {
  let arrays;
  try {
    const texts = parts.slice(0, 3).map((part) => part.replace(/-/g, "+").replace(/_/g, "/"));
    arrays = [Float64Array, Uint16Array, Uint8Array].map((Kind, index) => unpacked(texts[index], Kind));
  } catch {
    must(false, "shares, counts, checks and digest must all be there and whole");
  }
  const [shares, counts, checks, digest] = [...arrays, parts[3]];
  const lengths = Array.from(counts, (count) => count & 0x7fff);
  const total = lengths.reduce((sum, length) => sum + length, 0);
  must(
    shares.length === counts.length && lengths.every((length) => length > 0) && total > 0 && total === checks.length,
    `a game must have a count for each share and a check for each step, got ${shares.length}, ${counts.length} and ${checks.length}`,
  );
  const wrong = shares.find((share, run) => !(Math.abs(share) <= (counts[run] & 0x8000 ? 0 : 1)));
  must(wrong === undefined, `shares must be from -1 to 1, and 0 where the chirp acts, got ${wrong}`);
  must(/^[0-9a-f]{16}$/.test(digest), `digest must be 16 digits of 0-9 and a-f, got ${JSON.stringify(digest)}`);
  const steps = lengths.flatMap((length, run) => new Array(length).fill(counts[run] & 0x8000 ? null : shares[run]));
  return { shares: steps, checks, digest: BigInt(`0x${digest}`) };
}
