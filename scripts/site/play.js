// -- the page: who turns the box, numbers, keys, buttons ----------------------------------------------------------------

const READ = 80; // between new numbers [ms]
const RAMP = 0.5; // [s] that a key is held until the torque is at its limit
const SIDES = { ArrowLeft: 1, ArrowRight: -1 };
const pressed = new Map(); // keys and touches that turn the box: to which side, and whether a step has used them
const best = {}; // returns of this visit, by task
const player = { playing: false, agent: false, chirp: false, now: 0, push: 0, since: 0, drawn: null, read: -READ };

const say = (text) => (byId("message").textContent = text);
const drawn = () => Array.from(crypto.getRandomValues(new BigUint64Array(4)), (word, k) => String(k < 3 ? word : word | 1n));
const changed = () => Object.keys(game.fields).length > 0;

function restart(task = game.task, fields = game.fields, dt = 0.02, start = drawn(), recorded = null) {
  begin(task, fields, dt, start, recorded);
  Object.assign(player, { playing: Boolean(recorded) || player.agent || player.chirp, now: 0, push: 0 });
  byId("task").value = task;
  byId("goal").textContent = data.tasks[task].goal;
  for (const [name, field] of Object.entries(data.fields)) field.show(fields[name] ?? data.values[field.index]);
  say("");
  showReturns();
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
  while (game.shares.length !== game.recorded?.shares.length) {
    if (!game.open) openStep(nextShare());
    if (game.lost) break;
    if (player.now < game.time + game.dt) return;
    closeStep();
    if (game.shares.length === SCORED && !game.recorded) endEpisode();
  }
  Object.assign(player, { now: game.time, playing: false });
  if (game.lost) say("The jack moves too fast to be followed. R starts anew.");
  else endRecord();
}

function endEpisode() {
  const better = game.acted && !game.assisted && !changed() && !(best[game.task] >= game.scored);
  if (better) best[game.task] = game.scored;
  say(`10 s are over: ${fixed(game.scored, 1)}${better ? ", your best" : ""}. Play on, or R starts anew.`);
  showReturns();
}

function endRecord() {
  const same = !game.differs && game.digest === game.recorded.digest;
  const verdict = same ? "the same, bit for bit" : `another motion from step ${game.differs || game.shares.length} on`;
  say(`The shared game ends here, after ${game.shares.length} steps: ${verdict}. An arrow key plays on.`);
  takeOver();
}
const takeOver = () => Object.assign(game, { recorded: null, assisted: true });

function showReturns() {
  const others = changed() ? {} : { ...data.tasks[game.task].earned, "your best here": best[game.task] };
  const sorted = Object.entries(others).sort((a, b) => (b[1] ?? -Infinity) - (a[1] ?? -Infinity));
  const lines = [["return so far", game.scored], ...sorted].map(([name, value]) => {
    const line = make("tr");
    line.append(make("td", "", name), make("td", "", value === undefined ? "none yet" : fixed(value, value < 100 ? 1 : 0)));
    return line;
  });
  byId("returns").replaceChildren(...lines);
}

// -- numbers and plots ----------------------------------------------------------------------------------------------------

const panels = [
  {
    title: "energy", unit: "kJ",
    series: [series("gained", "energy", COLUMN.energy, false, 1e-3), series("work", "ink", COLUMN.work, true, 1e-3)],
  },
  { title: "box angle", unit: "rad", series: [series("\u03b8", "box", COLUMN.theta_box)] },
];
panels[0].series[0].wide = 5;
const times = make("canvas");
for (const panel of panels) byId("plots").append(legendOf(panel), (panel.canvas = make("canvas")));
byId("plots").append(times);

function drawPlots() {
  for (const panel of panels) {
    const { pen, width, height } = sharpen(panel.canvas);
    const y = drawFrame(pen, width, height, rangeOf(panel));
    const x = (time) => LEFT + ((width - LEFT - RIGHT) * (time - START)) / LASTS;
    drawImpacts(pen, x, height);
    for (const one of panel.series) drawSeries(pen, one, x, y);
    panel.outputs.forEach((output, number) => (output.textContent = general(panel.series[number].now(rows[COUNT - 1]), 4)));
  }
  drawTimes(times);
}

function show(moment) {
  stage.draw(player.now);
  const torque = stage.state[COLUMN.torque] / desk.scene[data.limit];
  byId("gauge").style.transform = `scaleX(${-torque})`; // a torque to the left shows to the left
  if (moment - player.read < READ) return;
  player.read = moment;
  const begun = game.shares.length > 0 || game.open;
  byId("clock").textContent = fixed(player.now, 1);
  byId("hits").textContent = game.hits;
  byId("torque").textContent = `${fixed(100 * torque, 0)} %`;
  byId("returns").firstChild.lastChild.textContent = fixed(game.scored, 1);
  byId("hint").hidden = player.playing || game.lost;
  byId("hint").firstChild.textContent = begun ? "Paused" : "Press \u2190 or \u2192, or touch a side";
  const on = { a: player.agent, c: player.chirp, " ": Boolean(begun) && !player.playing, r: false };
  for (const button of document.querySelectorAll("[data-key]")) button.setAttribute("aria-pressed", on[button.dataset.key]);
  drawPlots();
}

function tick(moment) {
  if (player.playing) advance(Math.min(0.1, (moment - (player.drawn ?? moment)) / 1000));
  player.drawn = moment;
  show(moment);
  requestAnimationFrame(tick);
}

// -- keys and touches -----------------------------------------------------------------------------------------------------

function press(key) {
  const name = { a: "agent", c: "chirp" }[key];
  if (key === " ") player.playing = !player.playing;
  else if (key === "r") typeof game.start[0] === "number" ? restart(game.task, game.fields, game.dt, game.start) : restart();
  else if (name) {
    player[name] = !player[name];
    player.playing ||= player[name];
    agents[game.task].restart();
  }
  return name || " r".includes(key);
}

function turn(by, side) {
  pressed.set(by, { side });
  player.playing = true;
  if (game.recorded) takeOver();
}

// A short press still turns the box in the next step.
function release(by) {
  const touch = pressed.get(by);
  if (touch?.used) pressed.delete(by);
  else if (touch) touch.released = true;
}

document.addEventListener("keydown", (event) => {
  const busy = event.target.matches("select, input") || byId("sharing").open || event.ctrlKey || event.metaKey || event.altKey;
  if (busy || (event.key === " " && event.target.matches("button"))) return;
  const side = SIDES[event.key];
  if (event.repeat || (side ? turn(event.key, side) : !press(event.key.toLowerCase()))) return;
  event.preventDefault();
});
document.addEventListener("keyup", (event) => release(event.key));
addEventListener("blur", () => pressed.clear());
byId("stage").addEventListener("pointerdown", (event) => {
  const { left, width } = byId("stage").getBoundingClientRect();
  byId("stage").setPointerCapture(event.pointerId);
  turn(event.pointerId, event.clientX < left + width / 2 ? 1 : -1);
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
byId("task").addEventListener("change", (event) => restart(event.target.value));
for (const id of ["task", "speed"]) byId(id).addEventListener("change", (event) => event.target.blur());

for (const [name, field] of Object.entries(data.fields)) {
  const [label, input, output] = [make("label", "slider"), make("input"), make("output")];
  const [to, from] = field.factors ? [Math.log, Math.exp] : [Number, Number];
  const value = () => Number(from(Number(input.value)).toPrecision(3));
  const write = (number) => (output.textContent = `${general(number, 3)} ${field.unit}`);
  Object.assign(input, { type: "range", step: "any", min: to(field.least), max: to(field.most) });
  field.show = (number) => write(number, (input.value = to(number)));
  input.addEventListener("input", () => write(value()));
  input.addEventListener("change", () => {
    const { [name]: _, ...others } = game.fields;
    restart(game.task, value() === data.values[field.index] ? others : { ...others, [name]: value() });
  });
  label.append(make("span", "", field.label), output, input);
  byId("sliders").append(label);
}

function open(text) {
  try {
    const read = readGame(text);
    restart(...read);
    player.playing = Boolean(read[4]);
  } catch (error) {
    if (!(error instanceof Refused)) throw error;
    say(`This game cannot be played: ${error.message}.`);
  }
}

byId("share").addEventListener("click", () => {
  player.playing = false;
  const [text, served] = [writeGame(), location.protocol.startsWith("http")];
  const fits = text.length <= data.mostText;
  byId("text").value = !fits ? "" : served ? `${location.href.split("#")[0]}#${encodeURIComponent(text)}` : text;
  byId("about-text").textContent = fits
    ? `${game.shares.length} steps. Any copy of this page plays ${served ? "this link" : "this text"}, and so does jackbox replay.`
    : `This game is too long to share: it has ${text.length} characters, at most ${data.mostText} fit.`;
  byId("sharing").showModal();
});
byId("sharing").addEventListener("close", () => byId("sharing").returnValue === "play" && open(byId("text").value));
byId("copy").addEventListener("click", () => {
  byId("text").select();
  navigator.clipboard?.writeText(byId("text").value).catch(() => document.execCommand("copy"));
});

readColours();
restart("juggle", {}, 0.02, data.seed);
const stage = makeStage();
const openLink = () => location.hash.length > 1 && open(location.hash);
const redraw = () => {
  readColours();
  stage.resize();
  player.read = -READ;
};
openLink();
addEventListener("hashchange", openLink);
new ResizeObserver(() => requestAnimationFrame(redraw)).observe(byId("stage"));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
requestAnimationFrame(tick);
