// What the page knows, and how it comes to be seen.

const state = { scene: null, motion: null, goals: null, frame: null, status: null, planning: null, moving: null, settings: null,
  said: [], services: [], role: { operator: false }, trail: null, file: "" };
let swarm = null, motion = null, recorded = null, link = null, pictures = null, last = null, isDue = false, rowsAt = 0, panelAt = 0, live = { rows: [], width: 2 };

const PANEL = 100; // ms from one change of the texts to the next, unless there is news besides poses

const plane = new Plane(byId("ground"), byId("swarm"), byId("hint"), null);
const volts = new Volts(byId("volts"));
const rows = new Rows(byId("robots"));
const player = new Player((time) => { recorded?.at(time); draw(); });
plane.onResize = volts.onResize = draw;
plane.goals = goalsNow;
plane.onChoose = () => { rowsAt = 0; };

function apply(kind, is) {
  if (kind === "file") return load(is);
  state[kind] = is;
  if (kind === "scene") {
    swarm = is && new Swarm(is);
    motion = last = null;
    live = { rows: [], width: 2 };
    if (!state.goals || state.goals.length !== swarm?.count) state.goals = is?.goals ?? null;
    rows.make(swarm, (row) => plane.choose(row));
    plane.stale();
  } else if (kind === "motion") {
    motion = is && swarm ? new Motion(swarm, is) : null;
    if (is && state.file) state.goals = is.goals;
    plane.stale();
  } else if (kind === "frame" && is && swarm) {
    last = last?.length === is.p.length ? last.map((value, k) => is.p[k] ?? value) : [...is.p];
    extendTrail(is.p);
  } else if (kind === "goals" && is) {
    // what this page has not told the server yet is newer
    state.goals = is.map((goal, row) => dragged.get(swarm?.robots[row]?.id) ?? goal);
  } else if (kind === "trail") live = { rows: is ?? [], width: 2 };
  else if (kind === "status" && is?.state === "IDLE" && state.before !== "IDLE") { live = { rows: [], width: 2 }; plane.stale(); }
  if (kind === "status") state.before = is?.state;
  else if (kind === "said") showSaid(is);
  else if (kind === "refused") alarm(is, 6000);
  else if (kind === "settings") showSettings(is);
  if (["services", "role", "status", "planning", "moving"].includes(kind)) enable();
  if (kind !== "frame") panelAt = 0;
  draw();
}

// Where robots have been, as stressbot_planner's view/trail.py keeps it.
function extendTrail(poses) {
  if (recorded) return;
  const before = live.rows.at(-1), places = [];
  let isNew = !before;
  for (let row = 0; row < poses.length / 3; row++) {
    const x = poses[3 * row], y = poses[3 * row + 1];
    places.push(x, y);
    if (before && x != null && !(Math.hypot(x - before[2 * row], y - before[2 * row + 1]) < 3)) isNew = true;
  }
  if (!isNew) return;
  live.rows.push(places);
  if (live.rows.length * places.length > 120000) live.rows = live.rows.filter((_, k) => k % 2 === 0);
}

function trail(time) {
  if (recorded) {
    const frames = recorded.kinds.frame, until = frames ? recorded.index("frame", time) : -1, kept = [];
    const every = Math.max(1, Math.floor(until / Math.min(400, SEGMENTS / swarm.count)));
    for (let k = 0; k <= until; k += every) kept.push(frames.contents[k].p);
    if (until >= 0) kept.push(frames.contents[until].p);
    return { rows: kept, width: 3 };
  }
  if (!state.file) return live;
  const { k } = motion.place(time), knots = [];
  for (let knot = Math.max(0, k - Math.floor(SEGMENTS / swarm.count)); knot <= k; knot++) knots.push(motion.knot(knot));
  return { rows: [...knots, motion.poses(time)], width: 3 };
}

function goalsNow() { return state.goals?.length === swarm?.count ? state.goals : swarm?.goals; }

// All that is to be seen, of one moment.
function now() {
  const status = state.status, isPlan = state.file === "PLAN";
  const is = isPlan || (motion && status?.plan && status.plan === motion.plan) ? motion : null;
  const time = isPlan ? player.time : is ? (status.state === "DONE" ? is.duration : status.state === "LOADED" ? 0 : state.frame?.t ?? status.t) : status?.t ?? 0;
  const isRunning = isPlan ? time < (is?.duration ?? 0) : status?.state === "RUNNING";
  const poses = swarm && (isPlan ? is?.poses(time) : state.frame?.p) || null;
  const segment = is && isRunning ? is.segment(time) : null;
  const isDriving = segment?.kind === "drive";
  const goals = goalsNow();
  const errors = poses && goals.map(([x, y], row) => poses[3 * row] == null ? null : Math.hypot(poses[3 * row] - x, poses[3 * row + 1] - y));
  return {
    scene: state.scene, swarm, motion: is, status, time, isRunning, poses, last, goals, errors,
    group: isDriving ? is.groups[segment.k] : null,
    isDown: isDriving && (swarm.volts.byLevel || Math.abs(segment.level) >= swarm.volts.pullDown),
    stuck: new Set(state.moving?.stuck ?? []),
    trail: swarm && (state.file === "PLAN" ? is && trail(time) : trail(player.time)),
  };
}

function draw() {
  if (isDue) return;
  isDue = true;
  requestAnimationFrame((at) => {
    isDue = false;
    sendGoals();
    const seen = now();
    plane.show(seen);
    const isWhole = plane.draw(at);
    volts.draw(seen.swarm, seen.motion, seen.time, seen.status?.level ?? 0);
    const isPanel = at > panelAt + PANEL;
    if (isPanel) { panelAt = at; showRun(state, seen); showSearch(state); showLoop(state); }
    const isDone = at > rowsAt + (swarm?.count > NAMED ? REDRAW_LARGE : REDRAW);
    if (isDone) { rowsAt = at; rows.show(seen, plane.chosen); }
    if (!isWhole || !isDone || !isPanel) later();
  });
}

// A last look, so that rows and ground do not stay behind.
let isLater = false;
function later() {
  if (isLater) return;
  isLater = true;
  setTimeout(() => { isLater = false; draw(); }, swarm?.count > NAMED ? REDRAW_LARGE : REDRAW);
}

// What the page may ask for

function alarm(text, time = 0) {
  setText("alarm", text);
  setHidden("alarm", !text);
  clearTimeout(alarm.timer);
  if (time) alarm.timer = setTimeout(() => setHidden("alarm", true), time);
}

function enable() {
  const may = state.role.operator && link?.isOpen, has = (name) => may && state.services?.includes(name), status = state.status?.state;
  const isBusy = status === "RUNNING" || state.moving?.active;
  byId("start").disabled = !has("start") || status !== "LOADED";
  byId("reset").disabled = !has("reset") || isBusy;
  const mayPlan = !isBusy && !state.planning?.active && status !== "FAULT";
  byId("plan").disabled = !has("plan") || !mayPlan;
  byId("move").disabled = !has("move") || !mayPlan;
  byId("cancel").disabled = !may || !(state.planning?.active || state.moving?.active);
  for (const id of ["goals", ...FIELDS]) byId(id).disabled = !may;
  setHidden("eye", !state.services?.includes("pictures") && !byId("camera").checked);
  plane.onGoal = may ? dragGoal : null;
  setText("hint", may && swarm && !isBusy ? "drag a goal ×" : "");
}

const dragged = new Map(); // goals by id that the server has not been told yet: it is, as often as the page is drawn

function sendGoals() {
  for (const [robot, [x, y]] of dragged) link.ask("goal", { robot, x, y });
  dragged.clear();
}

function dragGoal(row, x, y) {
  if (swarm.robots[row].parked) return;
  state.goals = state.goals.map((goal, k) => k === row ? [x, y] : goal);
  dragged.set(swarm.robots[row].id, [x, y]);
  plane.stale();
  draw();
}

const FIELDS = ["planner", "objective", "tolerance", "time_limit", "assign", "near", "patience"];

function showSettings(settings) {
  const planner = byId("planner");
  if (planner.options.length !== settings.planners.length) planner.replaceChildren(...settings.planners.map((name) => new Option(name)));
  for (const name of FIELDS) {
    const field = byId(name);
    if (name === "assign") field.checked = settings.assign;
    else if (document.activeElement !== field) field.value = settings[name];
  }
}

function sendSettings() {
  const sent = {};
  for (const name of FIELDS) {
    const field = byId(name);
    sent[name] = name === "assign" ? field.checked : field.type === "number" ? +field.value : field.value;
  }
  link.ask("settings", sent);
}

function stop() {
  if (!link.stop()) warnOfLoss(true);
}

let isStopUnsent = false;

function warnOfLoss(isStop = isStopUnsent) {
  isStopUnsent = isStop;
  if (isStop) alarm("STOP has not been sent: the page has lost its server. Stop by ros2 service call, or switch the amplifier off.");
  else alarm("The connection is lost; what runs goes on. Trying again …");
}

function goLive() {
  link = new Link(apply, (is) => {
    link.isOpen = is === "open";
    document.body.classList.toggle("lost", !link.isOpen);
    if (is === "open") { isStopUnsent = false; alarm(""); }
    else if (is === "lost") warnOfLoss();
    else alarm("The token in the address is wrong, perhaps of an earlier start: open the address that stressbot view has printed.");
    setText("link", is !== "open" ? "no connection" : state.role.operator || state.file ? "" : "looking on");
    enable();
  });
  pictures = new Pictures(byId("camera"), (picture) => {
    if (!picture !== !plane.picture) plane.stale();
    plane.picture = picture;
    draw();
  });
  byId("stop").addEventListener("click", stop);
  document.addEventListener("keydown", (event) => { if (event.key === "Escape") stop(); });
  for (const id of ["start", "reset", "plan", "cancel", "goals", "move"]) byId(id).addEventListener("click", () => link.ask(id));
  for (const name of FIELDS) byId(name).addEventListener("change", sendSettings);
}

// A plan or a recording, by kinds as on the server's board.
function load(data) {
  state.file = data.file;
  document.body.classList.add("file");
  document.title = `${data.scene?.name ?? "stressbot"} – stressbot`;
  if (data.recorded) {
    recorded = new Recorded(data.recorded, apply);
    player.load(data.duration);
  } else {
    apply("scene", data.scene);
    apply("motion", data.motion);
    player.load(motion.duration);
  }
}

const inside = document.getElementById("data");
if (inside) load(JSON.parse(inside.textContent)); else goLive();
