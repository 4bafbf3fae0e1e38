// -- a game: its steps, what the drawings read of them, and its text --------------------------------------------------

const SCORED = 500; // steps that count for the return
const FLASHES = 8; // impacts of a step that are drawn, at most
const BASIS = 0xcbf29ce484222325n; // of the digest, FNV-1a
const PRIME = 0x100000001b3n;

const physics = await loadPhysics(unpacked(data.module, Uint8Array), data).catch((error) => {
  console.error(error);
  const forbidden = !window.WebAssembly || `${error.message}`.includes("Content Security Policy");
  byId("hint").firstChild.textContent = forbidden
    ? "This browser, or the headers of this site, forbid WebAssembly, which this page needs: save the page and open the file."
    : `This page does not work here: ${error.message}`;
});
if (!physics) return;
const buffers = [physics.makeBuffer(), physics.makeBuffer(), physics.makeBuffer()];
const [main, preview, rival] = buffers; // for whole steps, for parts of a step, and for the ghost's steps
const [agents, ghosts] = [main, rival].map((buffer) => Object.fromEntries(
  Object.entries(data.tasks).map(([task, { agent }]) => {
    const weights = Float32Array.from(unpacked(agent.weights, Int16Array), (weight) => weight * agent.scale);
    return [task, buffer.agent({ ...agent, weights })];
  }),
));
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
    preview.step(open.state, open.time, Math.min(time - open.time, game.dt), open.torque);
    into.set(preview.after, 1);
    into[COLUMN.torque] = preview.number("MEAN_TORQUE");
  }
  into[0] = time;
  return into;
}

// `recorded`: a shared game to replay. `ghost`: whom to play against, { shares } of a shared game or of null, the agent.
function begin(task, fields, dt, start, recorded = null, ghost = null) {
  for (const one of buffers) one.setScene(valuesOf(fields));
  data.arm = main.scene[data.fields.jack_arm.index];
  data.knock = 2 * main.scene[data.fields.jack_mass.index] * data.speedScale; // the impulse of a hard impact [N s]
  const state = typeof start[0] === "string" ? main.start(start.map(BigInt)) : Float64Array.from(start, (number) => number + 0); // no -0, which JSON does not keep
  for (const one of buffers) one.place(state, dt, task);
  Object.assign(game, {
    task, fields, dt, start, recorded, state, time: 0, open: null, lost: false, acted: false, assisted: false,
    differs: 0, shares: [], checks: [], digest: BASIS, sum: 0, scored: 0, hits: 0, resting: false,
    energy: preview.number("ENERGY"), jackEnergy: preview.number("JACK_ENERGY"), ghost: ghost && { shares: ghost.shares, state, scored: 0 },
  });
  for (const one of [agents, ghosts]) one[task].restart();
  const row = new Float64Array(WIDTH);
  row.set(state, 1);
  measure(row);
  [rows, impacts, COUNT, START, END, LASTS] = [[row], [], 1, 0, SHORTEST, SHORTEST];
}

// Energies and momenta of the state in `preview`.
function measure(row) {
  for (let k = 0; k < 4; k++) row[COLUMN.jack_energy + k] = preview.number("JACK_ENERGY", k);
  row[COLUMN.jack_energy] -= game.jackEnergy;
}

// Begin a step under a share of the torque limit, or under the chirp (null).
function openStep(share) {
  const torque = share === null ? null : share * main.scene[data.torqueLimit];
  game.lost = !main.step(game.state, game.time, game.dt, torque);
  if (game.lost) return;
  const [next, resting] = [main.after.slice(), main.number("RESTING") > 0];
  const count = main.number("HITS") - main.number("RESTING"); // of impacts; feet at rest come after them
  const hits = main.impacts(Math.min(FLASHES, count));
  game.open = { time: game.time, state: game.state, next, share, torque, count, resting, reward: main.reward(game.task) };
  if (game.ghost && !game.ghost.over) openGhostStep(game.ghost);
  const moments = [0.25, 0.5, 0.75, 1].map((part) => ({ since: part * game.dt }));
  let [last, impulse] = [0, 0]; // the impulse of the torque since then [N m s]
  for (const moment of [...moments, ...hits].sort((a, b) => a.since - b.since)) {
    const { since, wall, foot } = moment;
    const row = rows[COUNT - 1].slice();
    if (since > last) {
      preview.step(game.state, game.time, since, torque);
      preview.reward(game.task);
      row.set(preview.after, 1);
      row[0] = game.time + since;
      row[COLUMN.torque] = (preview.number("MEAN_TORQUE") * since - impulse) / (since - last);
      const gained = preview.number("ENERGY") - game.energy;
      measure(row);
      row[COLUMN.energy] = Math.abs(gained) < 1e-12 * data.knock * data.speedScale ? 0 : gained; // else it is rounding
      row[COLUMN.work] += row[COLUMN.torque] * (row[COLUMN.theta_box] - at(COUNT - 1, COLUMN.theta_box));
      [last, impulse, COUNT] = [since, preview.number("MEAN_TORQUE") * since, rows.push(row)];
    }
    if (foot !== undefined) impacts.push({ time: row[0], wall, foot, impulse: moment.impulse, ...placeOf(row, foot) });
  }
}

function openGhostStep(ghost) {
  const share = ghost.shares ? ghost.shares[game.shares.length] : ghosts[game.task]();
  ghost.torque = share === null ? null : share * main.scene[data.torqueLimit];
  ghost.over = share === undefined || !rival.step(ghost.state, game.time, game.dt, ghost.torque);
  Object.assign(ghost, { next: rival.after.slice(), reward: rival.reward(game.task) });
}

// The ghost's 12 numbers at a time of the present step, or null: there is none, or its game is over.
function ghostAt(time) {
  const { open, ghost } = game;
  if (!ghost || ghost.over) return null;
  if (!open || time <= open.time) return ghost.state;
  preview.step(ghost.state, open.time, Math.min(time - open.time, game.dt), ghost.torque);
  return preview.after.slice();
}

function closeStep() {
  const { next, share, count, resting, reward } = game.open;
  for (const word of new BigUint64Array(next.buffer)) game.digest = BigInt.asUintN(64, (game.digest ^ word) * PRIME);
  game.checks.push(Number(game.digest >> 56n));
  const step = game.shares.push(share);
  if (game.recorded && game.recorded.checks[step - 1] !== game.checks[step - 1]) game.differs ||= step;
  game.sum += reward;
  if (step <= SCORED) game.scored = game.sum;
  if (game.ghost && !game.ghost.over) {
    game.ghost.state = game.ghost.next;
    if (step <= SCORED) game.ghost.scored += game.ghost.reward;
  }
  [game.state, game.time, game.open] = [next, game.time + game.dt, null];
  game.hits += count;
  game.resting = resting && count === 0;
  START = Math.max(0, game.time - KEPT);
  END = Math.max(game.time, SHORTEST);
  LASTS = END - START;
  rows = rows.filter((row) => row[0] >= START);
  impacts = impacts.filter((hit) => hit.time >= START);
  COUNT = rows.length;
}

// -- its text: JSON, described in jackbox_env/commands/game.py --------------------------------------------------------

function packed(array) {
  const letters = Array.from(new Uint8Array(array.buffer), (byte) => String.fromCharCode(byte));
  return btoa(letters.join("")).replace(/\+/g, "-").replace(/\//g, "_").replace(/=/g, "");
}

function writeGame() {
  const [shares, counts] = [[], []];
  game.shares.forEach((share, step) => {
    const continues = step && Object.is(share, game.shares[step - 1]) && (counts.at(-1) & 0x7fff) < 0x7fff;
    if (continues) counts[counts.length - 1]++;
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
const shown = (value) => {
  const text = JSON.stringify(value) ?? "nothing";
  return text.length > 80 ? `${text.slice(0, 80)}\u2026` : text;
};
const must = (condition, sentence) => {
  if (!condition) throw new Refused(sentence);
};

// The arguments of `begin` from a text, or from a link that ends in one.
function readGame(link) {
  let [text, values] = [link.slice(link.indexOf("#") + 1)];
  try {
    text = decodeURIComponent(text);
  } catch {} // a % of a text that is not encoded
  try {
    values = text.length <= data.mostText && JSON.parse(text);
  } catch {
    must(false, "the text is not a complete game: it is cut off or damaged");
  }
  must(text.length <= data.mostText, `a game must have at most ${data.mostText} characters, got ${text.length}`);
  must(values?.constructor === Object, "a game must be a JSON object");
  const { version, package: _, task = "juggle", scene, dt = 0.02, start, shares, counts, checks, digest, ...rest } = values;
  const [unknown, fields] = [Object.keys(rest)[0], scene ?? {}];
  must(version === data.version, `a game's version must be ${data.version}, which this page reads, got ${shown(version)}`);
  must(unknown === undefined, `a game has no ${shown(unknown)}`);
  const known = typeof task === "string" && Object.hasOwn(data.tasks, task);
  must(known, `task must be one of ${Object.keys(data.tasks).join(", ")}, got ${shown(task)}`);
  must(typeof dt === "number" && dt >= 0.001 && dt <= 1, `dt must be from 0.001 to 1 s, got ${shown(dt)}`);
  must(fields.constructor === Object, `scene must be an object of fields, got ${shown(fields)}`);
  for (const [name, value] of Object.entries(fields)) {
    must(Object.hasOwn(data.fields, name), `a game's scene has ${Object.keys(data.fields).join(", ")}, got ${shown(name)}`);
    checkField(value, data.fields[name]);
  }
  checkStart(start, fields);
  const texts = { shares, counts, checks, digest };
  return [task, fields, dt, start, Object.values(texts).some((text) => text !== undefined) ? readSteps(texts, dt) : null];
}

function checkField(value, { low, high, below, above }) {
  must(typeof value === "number" && value >= low, below.replace("{}", shown(value)));
  must(value <= high, above.replace("{}", value));
}

// The bodies' inertias in a scene, and how far a foot of a state is outside the box there [m].
function inspected(state, fields) {
  preview.setScene(valuesOf(fields));
  const inertias = Object.values(data.inertias).map((field) => [preview.scene[field.index], field]);
  const found = { inertias, outside: -preview.gap(state) };
  preview.setScene(main.scene);
  return found;
}

function checkStart(start, scene) {
  const [numbers, words] = ["number", "string"].map((kind) => Array.isArray(start) && start.every((one) => typeof one === kind));
  const isDrawn = words && start.length === 4 && start.every((word) => /^\d{1,20}$/.test(word) && BigInt(word) < 1n << 64n);
  const listed = numbers && start.length === 12 && start.every((one) => Math.abs(one) <= data.farthest);
  must(listed || (isDrawn && BigInt(start[3]) & 1n), "start must be 12 numbers within +-1e6, or the 4 words of a generator");
  const { inertias, outside } = inspected(isDrawn ? new Array(12).fill(0) : start, scene);
  for (const [inertia, field] of inertias) checkField(inertia, field);
  if (isDrawn) return;
  must(outside <= data.startTolerance, `a start must have every foot inside the box, got a foot ${outside} m outside`);
}

function readSteps(texts, dt) {
  const decoded = (name, Kind) => {
    try {
      if (/^[\w-]*$/.test(texts[name])) return unpacked(texts[name].replace(/-/g, "+").replace(/_/g, "/"), Kind);
    } catch {} // of another length
    throw new Refused(`${name} must be base64url without padding, of ${Kind.BYTES_PER_ELEMENT} bytes a number`);
  };
  const [shares, counts] = [decoded("shares", Float64Array), decoded("counts", Uint16Array)];
  const [checks, lengths] = [decoded("checks", Uint8Array), Array.from(counts, (count) => count & 0x7fff)];
  const total = lengths.reduce((sum, length) => sum + length, 0);
  must(
    shares.length === counts.length && lengths.every((length) => length > 0) && total > 0 && total === checks.length,
    `a game must have a count for each share and a check for each step, got ${shares.length}, ${counts.length} and ${checks.length}`,
  );
  must(total * dt <= data.mostSeconds, `a game must last at most ${data.mostSeconds} s, got ${total * dt} s`);
  const wrong = shares.find((share, run) => !(Math.abs(share) <= (counts[run] & 0x8000 ? 0 : 1)));
  must(wrong === undefined, `shares must be from -1 to 1, and 0 where the chirp acts, got ${wrong}`);
  const whole = typeof texts.digest === "string" && /^[0-9a-f]{16}$/.test(texts.digest);
  must(whole, `digest must be 16 digits of 0-9 and a-f, got ${shown(texts.digest)}`);
  const steps = lengths.flatMap((length, run) => new Array(length).fill(counts[run] & 0x8000 ? null : shares[run]));
  return { shares: steps, checks, digest: BigInt(`0x${texts.digest}`) };
}
