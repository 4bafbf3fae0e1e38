// -- the player: one time, which the animation, the plots and the list all show ----------------------------------------

const PLAY = "M8 5v14l11-7z";
const PAUSE = "M6 5h4v14H6zM14 5h4v14h-4z";
const FRAME = 1 / 60; // [s]
const READ = 80; // between new numbers beside the plots, while it plays [ms]
const secondsDigits = Math.min(6, Math.max(2, Math.ceil(-Math.log10(Math.max(LASTS, 1e-9) / 500))));
const KNOB = 8; // half of the slider's, which stays inside its track [px]

readColours();
let now = START;
let playing = false;
let resumes = false; // when a drag ends
let drawn = null; // when the last frame was [ms]
let read = 0; // when the numbers were last new [ms]
let track = 1; // width of the slider [px]
const seek = (time) => {
  now = Math.min(END, Math.max(START, time));
  show();
};
seek.begin = () => {
  resumes = playing;
  play(false);
};
seek.end = () => {
  if (resumes) play(true);
  resumes = false;
};

const slider = byId("slider");
slider.min = START;
slider.max = END;
const list = makeList();
const stage = makeStage();
const plots = [
  makePlots(byId("box-plots"), bodyPanels("box"), seek),
  makePlots(byId("jack-plots"), bodyPanels("jack"), seek),
  makePlots(byId("torque-plots"), torquePanels(), seek),
  makePlots(byId("energy-plots"), energyPanels(), seek),
  makePath(seek),
];
const mostTorque = mostOf(COLUMN.torque);
const torqueUnit = unitFor(mostTorque, "N m");

function makeList() {
  const most = impacts.reduce((found, hit) => Math.max(found, hit.impulse), 0);
  const shown = impacts.slice(0, data.listed).map((hit, number) => {
    const row = make("tr");
    row.dataset.number = number;
    const button = make("button", "", hit.time.toFixed(4));
    const time = make("td");
    time.append(button);
    const foot = make("td");
    foot.append(make("i", hit.foot === 0 ? "dot foot" : "dot"), String(hit.foot));
    const impulse = make("td", "", general(hit.impulse, 4));
    impulse.style.setProperty("--share", `${(100 * hit.impulse) / most}%`);
    row.append(time, make("td", "", String(hit.wall)), foot, impulse);
    byId("impacts").append(row);
    return row;
  });
  byId("impacts").addEventListener("click", (event) => {
    const row = event.target.closest("tr");
    if (!row) return;
    play(false);
    seek(impacts[row.dataset.number].time);
  });
  let marked = -1;
  return (number) => {
    if (number === marked) return;
    if (shown[marked]) shown[marked].classList.remove("now");
    marked = number;
    const box = byId("rows");
    if (number < 0) box.scrollTop = 0;
    else if (shown[number]) {
      shown[number].classList.add("now");
      const top = shown[number].offsetTop;
      const inside = top > box.scrollTop + 30 && top < box.scrollTop + box.clientHeight - 60;
      if (!inside) box.scrollTop = top - box.clientHeight / 2;
    }
  };
}

// Show the present time. Numbers cost a layout, so while it plays they are written less often than frames are drawn.
function show(numbers = true) {
  stage.draw(now);
  const share = LASTS ? (now - START) / LASTS : 0;
  byId("clock").textContent = fixed(now, secondsDigits);
  byId("gone").style.transform = `scaleX(${share})`;
  byId("knob").style.transform = `translateX(${share * (track - 2 * KNOB)}px)`;
  const torque = stage.state[COLUMN.torque];
  byId("gauge").style.transform = `scaleX(${mostTorque ? torque / mostTorque : 0})`;
  for (const plot of plots) plot.show(stage.state, numbers);
  if (!numbers) return;
  const count = impactsBy(now);
  byId("hits").textContent = count;
  byId("torque").textContent = `${fixed(torque / torqueUnit.value, 1)} ${torqueUnit.symbol}`;
  slider.value = now;
  list(count - 1);
}

function play(on) {
  if (on && now >= END) now = START;
  playing = on;
  drawn = null;
  if (!on) show();
  byId("icon").setAttribute("d", on ? PAUSE : PLAY);
  byId("play").setAttribute("aria-label", on ? "Pause" : "Play");
}

function tick(moment) {
  if (playing) {
    const passed = drawn === null ? 0 : Math.min(0.25, (moment - drawn) / 1000);
    drawn = moment;
    now += passed * Number(byId("speed").value);
    if (now >= END && byId("loop").checked) now = START;
    else if (now >= END) {
      now = END;
      play(false);
    }
    const due = moment - read >= READ || !playing;
    if (due) read = moment;
    show(due);
  }
  requestAnimationFrame(tick);
}

// To the impact before the present time, or to the next.
function jump(direction) {
  const count = impactsBy(now + (direction > 0 ? 1e-9 * LASTS : 0));
  const target = impacts[direction > 0 ? count : impactsBy(now - 1e-9 * LASTS) - 1];
  play(false);
  seek(target ? target.time : direction > 0 ? END : START);
}

function drawTicks() {
  const { pen, width, height } = sharpen(byId("ticks"));
  track = width;
  pen.fillStyle = colours.hit;
  pen.globalAlpha = impacts.length > 200 ? 0.25 : 0.8;
  const places = impacts.map((hit) => KNOB + (LASTS ? (hit.time - START) / LASTS : 0) * (width - 2 * KNOB));
  for (const place of apart(places, 1)) pen.fillRect(place - 0.75, 0, 1.5, 7);
}

function redraw() {
  readColours();
  stage.resize();
  for (const plot of plots) plot.resize();
  drawTicks();
  show();
}

function describe() {
  const many = impacts.length.toLocaleString("en");
  const facts = data.facts.map(([name, value]) => `${name} ${value}`);
  byId("subtitle").textContent = [data.title, ...facts.slice(0, 1), `${many} impacts`].join(" \u00b7 ");
  document.title = `Jack in a box: ${data.title}`;
  byId("hits-of").textContent = `of ${many} impacts`;
  byId("count").textContent = many;
  for (const [name, value] of data.facts) {
    const entry = make("div");
    entry.append(make("dt", "", name), make("dd", "", value));
    byId("facts").append(entry);
  }
  for (const note of data.notes) byId("notes").append(make("p", "note", note));
  for (const speed of [0.05, 0.1, 0.25, 0.5, 1, 2, 4]) {
    const option = make("option", "", `${speed}\u00d7`);
    option.value = speed;
    option.selected = speed === 1;
    byId("speed").append(option);
  }
}

function listen() {
  byId("play").addEventListener("click", () => play(!playing));
  byId("before").addEventListener("click", () => jump(-1));
  byId("after").addEventListener("click", () => jump(1));
  slider.addEventListener("pointerdown", seek.begin);
  slider.addEventListener("input", () => {
    const value = Number(slider.value); // rounded by the browser
    seek(value > END - 1e-9 * LASTS ? END : value);
  });
  slider.addEventListener("change", seek.end);
  slider.addEventListener("pointerup", seek.end);
  document.addEventListener("click", (event) => {
    // What the mouse has pressed does not keep Space to itself.
    if (event.detail) event.target.closest("button, input[type=checkbox]")?.blur();
  });
  document.addEventListener("keydown", (event) => {
    if (event.target.matches("select") || event.ctrlKey || event.metaKey || event.altKey) return;
    const direction = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    const pressed = event.target.matches("input[type=checkbox], button"); // takes Space and Enter itself
    if (event.key === " " && !pressed) play(!playing);
    else if (direction && event.shiftKey) jump(direction);
    else if (direction) {
      play(false);
      seek(now + direction * FRAME);
    } else return;
    event.preventDefault();
  });
  const parts = [document.body, byId("stage"), byId("path")];
  let sizes = "";
  const observer = new ResizeObserver(() => {
    const [page, ...drawings] = parts.map((part) => part.getBoundingClientRect()); // the page's height is its text's
    const found = [page.width, ...drawings.flatMap(({ width, height }) => [width, height])].join();
    if (found !== sizes) requestAnimationFrame(redraw);
    sizes = found;
  });
  for (const part of parts) observer.observe(part);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
}

describe();
listen();
drawTicks();
play(true);
show();
requestAnimationFrame(tick);
