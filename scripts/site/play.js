// -- the page: who turns the box, numbers, keys, buttons ----------------------------------------------------------------

const READ = 80; // between new numbers [ms]
const SLOWEST = 50; // computing time of a frame; a slow machine plays slower [ms]
const RAMP = 0.8; // [s] that a key is held until the torque is at its limit
const START_HINT = "Press here or Space. Then \u2190 and \u2192, or a press left or right, turn the box.";
const SIDES = { ArrowLeft: 1, ArrowRight: -1 };
const pressed = new Map(); // keys and touches that turn the box: to which side, and whether a step has used them
const best = {}; // returns of this visit, by task
const player = { playing: false, agent: false, chirp: false, ghost: null, now: 0, push: 0, since: 0, drawn: null, read: -READ };

const inQuestion = () => !byId("question").hidden;
const say = (text) => (byId("message").textContent = text);
const randomWords = () => Array.from(crypto.getRandomValues(new BigUint64Array(4)), (word, k) => String(k < 3 ? word : word | 1n));
const changed = () => Object.keys(game.fields).length > 0;

function restart(task, fields, dt, start, recorded = null, shared = true) {
  begin(task, fields, dt, start, recorded, player.ghost);
  game.assisted = shared;
  Object.assign(player, { playing: Boolean(recorded) || player.agent || player.chirp || inQuestion(), now: 0, push: 0 });
  byId("task").value = task;
  byId("goal").textContent = data.tasks[task].goal;
  for (const [name, field] of Object.entries(data.fields)) field.show(fields[name] ?? data.values[field.index]);
  say(recorded ? "A shared game plays. An arrow key takes over." : "");
  showReturns();
}

// Start again: from a start that was set, or that of a shared game as a ghost, if it fits into the scene, else from another.
function again(task = game.task, fields = game.fields) {
  if (player.ghost?.shares && fields !== game.fields) player.ghost = null; // it played in another scene
  const listed = typeof game.start[0] === "number" && inspected(game.start, fields).outside <= data.startTolerance;
  const repeats = listed || Boolean(player.ghost?.shares);
  restart(task, fields, repeats ? game.dt : 0.02, repeats ? game.start : randomWords(), null, repeats);
}

// The share of the torque limit in the next step: recorded, a pressed key's, the agent's, 0; null: the chirp.
function nextShare() {
  if (game.recorded) return game.recorded.shares[game.shares.length];
  let push = 0;
  for (const [by, touch] of pressed) {
    push += touch.side;
    touch.used = true;
    if (touch.released) pressed.delete(by);
  }
  push = Math.sign(push);
  player.since = push === player.push ? player.since + game.dt : game.dt;
  player.push = push;
  game.acted ||= push !== 0;
  game.assisted ||= push === 0 && (player.agent || player.chirp);
  if (push === 0) return player.agent ? agents[game.task]() : player.chirp ? null : 0;
  agents[game.task].restart(); // it decides anew when it acts again
  return (push * Math.min(32, Math.ceil((32 * player.since) / RAMP))) / 32;
}

function advance(seconds) {
  player.now += seconds * Number(byId("speed").value);
  const late = performance.now() + SLOWEST;
  while (game.shares.length !== game.recorded?.shares.length) {
    if (!game.open) openStep(nextShare());
    if (game.lost) break;
    if (performance.now() > late) player.now = Math.min(player.now, game.time + 0.999 * game.dt);
    if (player.now < game.time + game.dt) return;
    closeStep();
    if (game.shares.length === SCORED && !game.recorded && !inQuestion()) endEpisode();
  }
  Object.assign(player, { now: game.time, playing: false });
  if (game.lost) say("The jack moves too fast to be followed. Press R to start again.");
  else endRecord();
}

function endEpisode() {
  const counts = game.acted && !game.assisted && !changed();
  const better = counts && !(best[game.task] >= game.scored);
  if (better) best[game.task] = game.scored;
  const note = better ? ", your best here" : game.assisted ? ", not counted as yours: the agent, the chirp or a shared start helped" : "";
  say(`${general(SCORED * game.dt, 2)} s are over: the return is ${fixed(game.scored, 1)}${note}. Play on, or press R to start again.`);
  showReturns();
}

function endRecord() {
  const same = !game.differs && game.digest === game.recorded.digest;
  const verdict = same ? "the same, bit for bit" : `it differs from step ${game.differs || game.shares.length} on`;
  say(`The shared game ends here, after ${game.shares.length} steps: ${verdict}. An arrow key plays on.`);
  Object.assign(game, { recorded: null, assisted: true });
}

function showReturns() {
  const others = changed() ? {} : { ...data.tasks[game.task].earned, "your best here": best[game.task] };
  const sorted = Object.entries(others).sort((a, b) => (b[1] ?? -Infinity) - (a[1] ?? -Infinity));
  const now = [["return so far", game.scored], ...(game.ghost ? [["the ghost's", game.ghost.scored]] : [])];
  const lines = [...now, ...sorted].map(([name, value]) => {
    const line = make("tr");
    line.append(make("td", "", name), make("td", "", value === undefined ? "none yet" : fixed(value, value < 100 ? 1 : 0)));
    return line;
  });
  byId("returns").replaceChildren(...lines);
  byId("compared").textContent = changed()
    ? "Another scene: there is nothing to compare with." : "Returns of the first 10 s, at most 500. The others' are means over many starts.";
}

// -- numbers and plots ----------------------------------------------------------------------------------------------------

const panels = [
  {
    title: "energy gained", unit: "J",
    series: [
      series("all", "energy", COLUMN.energy), series("jack", "jack", COLUMN.jack_energy),
      series("box", "box", COLUMN.energy, true), series("work", "ink", COLUMN.work, true),
    ],
  },
  { title: "box angle", unit: "rad", series: [series("\u03b8", "box", COLUMN.theta_box)] },
  { title: "height", unit: "m", series: [series("jack", "jack", COLUMN.y_jack), series("box", "box", COLUMN.y_box, true)] },
  { title: "upward velocity", unit: "m/s", series: [series("jack", "jack", COLUMN.vy_jack), series("box", "box", COLUMN.vy_box, true)] },
  { title: "jack's spin", unit: "rad/s", series: [series("\u03c9", "jack", COLUMN.omega_jack)] },
  {
    title: "momentum", unit: "kg m/s",
    series: [series("x", "ink", COLUMN.momentum_x), series("y", "ink", COLUMN.momentum_y, true)],
  },
  { title: "angular momentum", unit: "kg m\u00b2/s", series: [series("L", "ink", COLUMN.angular_momentum)] },
];
const boxGain = (row) => row[COLUMN.energy] - row[COLUMN.jack_energy];
Object.assign(panels[0].series[2], { values: (row) => boxGain(rows[row]), now: boxGain });
panels[0].series[0].wide = 5;
const times = make("canvas");
for (const panel of panels) byId("plots").append(legendOf(panel), (panel.canvas = make("canvas")));
byId("plots").append(times);

// The row that the plots show in numbers: under the pointer, at a tenth of a second, so that two pages can be compared, or
// at an impact close by, unless it is on the heights, which no impact changes; else the last.
let pointer = null; // the event
for (const kind of ["pointerdown", "pointermove"]) byId("plots").addEventListener(kind, (event) => (pointer = event));
byId("plots").addEventListener("pointerleave", () => (pointer = null));

function pointedRow() {
  if (pointer === null) return rows[COUNT - 1];
  const { left, width } = times.getBoundingClientRect();
  const pixel = LASTS / (width - LEFT - RIGHT); // [s]
  const under = START + pixel * (pointer.clientX - left - LEFT);
  const near = (hit) => pointer.target !== panels[2].canvas && Math.abs(hit.time - under) < 2 * pixel;
  const time = impacts.find(near)?.time ?? Math.round(10 * under) / 10;
  return rows[rowAt(Math.max(at(0, 0), time + 1e-9))]; // a step's end is not exactly a tenth
}

function drawPlots() {
  const row = pointedRow();
  for (const panel of panels) {
    const { pen, width, height } = sharpen(panel.canvas);
    const y = drawFrame(pen, width, height, rangeOf(panel));
    const x = (time) => LEFT + ((width - LEFT - RIGHT) * (time - START)) / LASTS;
    drawImpacts(pen, x, height);
    for (const one of panel.series) drawSeries(pen, one, x, y);
    panel.outputs.forEach((output, number) => (output.textContent = general(panel.series[number].now(row), 4)));
    pen.fillStyle = colours.ink;
    if (pointer !== null) pen.fillRect(x(row[0]), 0, 1, height);
  }
  drawTimes(times);
  if (pointer === null) return;
  const [pen, place] = [times.getContext("2d"), LEFT + ((times.clientWidth - LEFT - RIGHT) * (row[0] - START)) / LASTS];
  pen.clearRect(place - 30, 0, 60, 20);
  pen.fillStyle = colours.ink;
  pen.textAlign = "center";
  pen.fillText(`${fixed(row[0], 2)} s`, Math.min(times.clientWidth - 20, place), 4);
}

function show(moment) {
  stage.draw(player.now, ghostAt(player.now));
  const torque = stage.state[COLUMN.torque] / main.scene[data.torqueLimit]; // the chirp's may be beyond 1
  byId("gauge").style.transform = `scaleX(${Math.max(-1, Math.min(1, -torque))})`; // to the left shows to the left
  if (moment - player.read < READ) return;
  player.read = moment;
  const begun = game.shares.length > 0 || game.open;
  byId("clock").textContent = fixed(player.now, !begun || (player.playing && byId("speed").value >= 1) ? 1 : 2);
  byId("hits").textContent = game.hits;
  byId("rest").hidden = !game.resting;
  byId("torque").textContent = `${fixed(100 * torque, 0)} %`;
  [game, game.ghost].forEach((one, row) => one && (byId("returns").rows[row].lastChild.textContent = fixed(one.scored, 1)));
  const over = player.playing && !inQuestion() && game.shares.length >= SCORED && game.shares.length < SCORED + 150;
  byId("hint").hidden = !over && (player.playing || game.lost);
  byId("hint").firstChild.textContent = over ? `Return ${fixed(game.scored, 1)}` : begun ? "Paused" : START_HINT;
  const on = { a: player.agent, c: player.chirp, g: Boolean(player.ghost), " ": Boolean(begun) && !player.playing, r: false };
  for (const button of document.querySelectorAll("[data-key]")) button.setAttribute("aria-pressed", on[button.dataset.key]);
  drawPlots();
}

function tick(moment) {
  requestAnimationFrame(tick);
  if (player.playing) advance(Math.min(0.1, (moment - (player.drawn ?? moment)) / 1000));
  player.drawn = moment;
  show(moment);
}

// -- keys and touches -----------------------------------------------------------------------------------------------------

function press(key) {
  const name = { a: "agent", c: "chirp" }[key];
  if (key === " ") player.playing = !player.playing;
  else if (key === "r") again();
  else if (key === "g") {
    player.ghost = player.ghost ? null : { shares: null };
    again();
  }
  else if (name) {
    Object.assign(player, { agent: false, chirp: false, [name]: !player[name] });
    player.playing ||= player[name];
    agents[game.task].restart();
  }
}

function turn(by, side) {
  pressed.set(by, { side });
  player.playing = true;
  if (game.recorded) Object.assign(game, { recorded: null, assisted: true }); // and the player takes over
}

// A short press still turns the box in the next step.
function release(by) {
  const touch = pressed.get(by);
  if (touch?.used) pressed.delete(by);
  else if (touch) touch.released = true;
}

document.addEventListener("keydown", (event) => {
  const chooses = event.target.matches("select") || (event.target.matches("input") && event.key in SIDES);
  const busy = chooses || byId("sharing").open || event.ctrlKey || event.metaKey || event.altKey;
  if (busy || (event.key === " " && event.target.matches("button"))) return;
  const key = event.key.toLowerCase();
  if (!(event.key in SIDES) && !"acgr ".includes(key)) return;
  event.preventDefault();
  if (event.repeat) return;
  if (event.key in SIDES) turn(event.key, SIDES[event.key]);
  else press(key);
});
document.addEventListener("keyup", (event) => release(event.key));
addEventListener("blur", () => pressed.clear());
byId("stage").addEventListener("pointerdown", (event) => {
  if (event.button !== 0) return;
  const { left, width } = byId("stage").getBoundingClientRect();
  byId("stage").setPointerCapture(event.pointerId);
  if (inQuestion() || !player.playing) player.playing = !player.playing; // of a question: a press turns nothing
  else turn(event.pointerId, event.clientX < left + width / 2 ? 1 : -1);
});
for (const end of ["pointerup", "pointercancel"]) byId("stage").addEventListener(end, (event) => release(event.pointerId));
for (const button of document.querySelectorAll("[data-key]")) {
  button.addEventListener("click", (event) => {
    press(button.dataset.key);
    if (event.detail) button.blur(); // what the mouse has pressed does not keep Space to itself
  });
}

// -- choices, sliders, sharing --------------------------------------------------------------------------------------------

byId("task").append(...Object.keys(data.tasks).map((task) => make("option", "", task)));
byId("task").addEventListener("change", (event) => again(event.target.value));
for (const id of ["task", "speed"]) byId(id).addEventListener("change", (event) => event.target.blur());

for (const [name, field] of Object.entries(data.fields)) {
  const [label, input, output] = [make("label", "slider"), make("input"), make("output")];
  const [to, from] = field.logarithmic ? [Math.log, Math.exp] : [Number, Number];
  const value = () => Number(from(Number(input.value)).toPrecision(3));
  const write = (number) => (output.textContent = `${general(number, 3)} ${field.unit}`);
  Object.assign(input, { type: "range", step: "any", min: to(field.least), max: to(field.most) });
  field.show = (number) => write(number, (input.value = to(number)));
  input.addEventListener("input", () => write(value()));
  input.addEventListener("pointerup", () => input.blur()); // so that the arrow keys turn the box again
  input.addEventListener("change", () => {
    const { [name]: _, ...others } = game.fields;
    again(game.task, value() === data.values[field.index] ? others : { ...others, [name]: value() });
  });
  label.append(make("span", "", field.label), output, input);
  byId("sliders").append(label);
}

// Play a game from its text: replay it, or play `against` it. `asked`: whether it is a scene of the question.
function open(text, against = false, asked = false) {
  try {
    const read = readGame(text);
    must(!against || read[4], "it has no steps to play against");
    if (!asked) showQuestion(0);
    player.ghost = against && read[4];
    if (against) read[4] = null;
    restart(...read);
    player.playing = Boolean(read[4]);
  } catch (error) {
    say(`This game cannot be played: ${error instanceof Refused ? error.message : "it is damaged"}.`);
  }
}

byId("share").addEventListener("click", () => {
  player.playing = false;
  const [text, served] = [writeGame(), location.protocol.startsWith("http")];
  const lasts = game.shares.length * game.dt;
  const fits = text.length <= data.mostText && lasts <= data.mostSeconds;
  byId("text").value = !fits ? "" : served ? `${location.href.split("#")[0]}#${encodeURIComponent(text)}` : text;
  byId("about-text").textContent = fits
    ? `Send ${served ? "this link" : "this text"}: any copy of this page replays the ${game.shares.length} steps, and jackbox replay checks them bit for bit.`
    : `This game is too long to share: it has ${text.length} characters and lasts ${general(lasts, 4)} s, at most are ${data.mostText} and ${data.mostSeconds} s.`;
  byId("copy").textContent = "Copy";
  byId("sharing").returnValue = "";
  byId("sharing").showModal();
});
byId("sharing").addEventListener("close", () => {
  byId("share").blur(); // so that Space does not open it again
  if (byId("sharing").returnValue) open(byId("text").value, byId("sharing").returnValue === "against");
});
byId("copy").addEventListener("click", () => {
  byId("text").select();
  byId("copy").textContent = document.execCommand("copy") ? "Copied" : "Press Ctrl+C";
});

// -- the lesson: questions, whose links are scenes -----------------------------------------------------------------------

byId("lesson").append(...["none", ...data.lesson.map((one, k) => `${k + 1}. ${one.title}`)].map((title, k) => {
  return Object.assign(make("option", "", title), { value: k });
}));

function showQuestion(number) {
  const asked = data.lesson[number - 1];
  byId("lesson").value = number;
  byId("question").hidden = !asked;
  if (asked) byId("question").innerHTML = `<h2>${number}. ${asked.title}</h2><p>${asked.question}</p>
    <details><summary>Answer</summary><p>${asked.answer}</p></details>`;
}

function ask(number) {
  showQuestion(number);
  if (number) byId("question").querySelector("a").click();
  else restart("juggle", {}, 0.02, randomWords(), null, false);
}

byId("lesson").addEventListener("change", (event) => {
  ask(Number(event.target.value));
  event.target.blur();
});
byId("question").addEventListener("click", (event) => {
  const link = event.target.closest("a");
  if (!link) return;
  event.preventDefault();
  Object.assign(player, { agent: false, chirp: false });
  open(link.getAttribute("href"), false, true);
  player.playing = true;
  link.blur(); // so that Space pauses
  byId("stage").scrollIntoView({ block: "nearest" });
});

readColours();
restart("juggle", {}, 0.02, data.seed, null, false);
const stage = makeStage();
const openLink = () => location.hash.length > 1 && open(location.hash);
const redraw = () => {
  readColours();
  stage.resize();
  player.read = -READ;
};
const asked = new URLSearchParams(location.search).get("scene");
if (data.lesson[asked - 1]) ask(Number(asked));
else if (asked !== null) say(`scene must be from 1 to ${data.lesson.length}, got ${asked || "nothing"}`);
openLink();
addEventListener("hashchange", openLink);
new ResizeObserver(() => requestAnimationFrame(redraw)).observe(byId("stage"));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
requestAnimationFrame(tick);
