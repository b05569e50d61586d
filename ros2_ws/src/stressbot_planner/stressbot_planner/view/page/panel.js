// What stands beside the substrate. Texts are set only where they change: the page is drawn often.

const ROWS = 64; // robots that all have a row; of more, those farthest from their goals

const byId = (id) => document.getElementById(id);

function setText(id, text) {
  const element = byId(id);
  if (element.textContent !== text) element.textContent = text;
}

function setHidden(id, isHidden) {
  if (byId(id).hidden !== isHidden) byId(id).hidden = isHidden;
}

// Of the run: state, fault and what to do, epochs and time left.
function showRun(state, seen) {
  const { status, motion, swarm } = seen, file = state.file;
  setText("name", seen.scene?.name ?? "stressbot");
  const place = byId("place"), pill = byId("state");
  setText("place", file ? (status?.place ? `${file} OF A${status.place === "INSTRUMENT" ? "N" : ""} ${status.place}` : file) : status?.place ?? "");
  place.className = `pill ${file && !status?.place ? "FILE" : status?.place ?? ""}`;
  place.title = status?.backend ? `backend: ${status.backend}` : "";
  setText("state", status?.state ?? (file ? "" : "…"));
  pill.className = `pill ${status?.state ?? ""}`;
  setText("advice", file ? (status ? status.advice : "") : status?.advice ?? "waiting for the nodes");
  setText("fault", status?.message ? `${status.code ? `${status.code}: ` : ""}${status.message}` : "");
  setHidden("fault", !status?.message);
  const isRun = motion && motion.count > 0;
  const epochs = status?.epochs || motion?.count || 0;
  const segment = isRun ? motion.segment(seen.time) : null;
  const duration = motion?.duration || status?.duration || 0;
  const done = status && !motion ? status.epoch : segment ? segment.k : 0;
  byId("done").value = epochs ? done / epochs : 0;
  setText("epochs", epochs ? `epoch ${Math.min(done + (seen.isRunning ? 1 : 0), epochs)} of ${epochs}` : "");
  setText("left", duration ? `${timeText(seen.time)} of ${timeText(duration)}, ${timeText(Math.max(duration - seen.time, 0))} left` : "");
  let group = "";
  if (seen.group !== null) {
    const members = swarm.members(seen.group);
    group = `G${seen.group} drives: ${members.length === 0 ? "all turn" : members.length > 12 ? `${members.length} slide` : `${members.join(", ")} slide`}`;
  } else if (seen.isRunning && segment && segment.k < motion.count) group = `selecting G${motion.groups[segment.k]}`;
  setText("group", group);
  const level = seen.isRunning && segment ? segment.level : status?.level ?? 0;
  setText("level", swarm ? `${+level.toPrecision(4)} V` : "");
  const figures = [];
  if (motion) {
    if (motion.planner) figures.push(motion.planner + (motion.solved === false ? " (no plan found: closest attempt)" : ""));
    if (motion.path) figures.push(`path ${lengthText(motion.path)}${motion.bounds?.[0] ? `, ${(motion.path / motion.bounds[0]).toFixed(2)} × the bound` : ""}`);
    figures.push(`${motion.count} activations`);
    if (motion.clearance != null) figures.push(`clearance ${lengthText(motion.clearance)}`);
  }
  setText("figures", figures.join(" · "));
}

// Of the search for a plan: how far it has got, and the cost that falls.
function showSearch(state) {
  const { planning, settings } = state;
  if (!planning) return;
  const isTime = settings?.objective === "time", column = isTime ? 2 : 1;
  let text = "";
  if (planning.active) {
    const left = planning.limit ? `, ${timeText(Math.max(planning.limit - planning.elapsed, 0))} left` : "";
    text = `planning for ${timeText(planning.elapsed)}${left}${planning.tries ? `, ${planning.tries} tries` : ""}: `;
    text += planning.found ? "" : "no plan yet";
  } else if (planning.history?.length) text = "the last search: ";
  if (planning.history?.length) {
    const best = planning.history.at(-1)[column], bound = planning.bounds?.[isTime ? 1 : 0];
    text += `best ${isTime ? timeText(best) : lengthText(best)}${bound ? `, ${(best / bound).toFixed(2)} × the bound` : ""}`;
  }
  setText("search", text);
  setHidden("cost", !planning.history?.length);
  if (planning.history?.length) drawCost(planning, column);
}

function drawCost(planning, column) {
  const canvas = byId("cost"), ratio = Math.min(window.devicePixelRatio || 1, 2), context = canvas.getContext("2d");
  canvas.width = Math.round(canvas.clientWidth * ratio);
  canvas.height = Math.round(canvas.clientHeight * ratio);
  context.scale(ratio, ratio);
  const width = canvas.width / ratio, height = canvas.height / ratio, { history } = planning;
  const bound = planning.bounds?.[column - 1] ?? Math.min(...history.map((row) => row[column]));
  const top = Math.max(...history.map((row) => row[column]), bound * 1.0001), until = Math.max(planning.elapsed, history.at(-1)[0], 0.1);
  const x = (time) => 4 + (width - 8) * time / until, y = (cost) => 8 + (height - 24) * (top - cost) / (top - bound || 1);
  context.strokeStyle = "#d9dee5";
  context.setLineDash([4, 3]);
  context.beginPath(); context.moveTo(0, y(bound)); context.lineTo(width, y(bound)); context.stroke();
  context.setLineDash([]);
  context.strokeStyle = "#0072b2";
  context.lineWidth = 2;
  context.beginPath();
  history.forEach((row, k) => { if (k) context.lineTo(x(row[0]), y(history[k - 1][column])); context.lineTo(x(row[0]), y(row[column])); });
  context.lineTo(x(until), y(history.at(-1)[column]));
  context.stroke();
  context.fillStyle = "#5b6675";
  context.font = "11px system-ui, sans-serif";
  if (planning.bounds) context.fillText("lower bound", 4, height - 3);
  context.textAlign = "right";
  context.fillText(timeText(until), width - 2, height - 3);
}

function showLoop(state) {
  const moving = state.moving;
  if (!moving) return;
  setHidden("moved", !moving.active);
  byId("moved").value = moving.progress;
  const worst = Math.max(0, ...Object.values(moving.errors));
  const counts = `${moving.activations} activations, ${moving.plans} plans, ${moving.corrections} corrections`;
  const stuck = moving.stuck.length ? `; stuck: ${moving.stuck.join(", ")}` : "";
  setText("loop", moving.active || moving.activations ? `${moving.active ? "moving" : "ended"}, worst ${lengthText(worst)}; ${counts}${stuck}` : "");
}

// The robots' rows: made once a swarm, and then only what changes.
class Rows {
  constructor(body) { this.body = body; }

  make(swarm, onChoose) {
    this.swarm = swarm;
    this.rows = [];
    const count = Math.min(swarm?.count ?? 0, ROWS);
    this.body.replaceChildren(...Array.from({ length: count }, () => {
      const line = document.createElement("tr"), cells = [0, 1, 2, 3].map(() => line.appendChild(document.createElement("td")));
      const row = { line, cells, robot: -1 };
      line.addEventListener("click", () => onChoose(row.robot));
      this.rows.push(row);
      return line;
    }));
    setText("more", swarm && swarm.count > ROWS ? `the ${ROWS} of ${swarm.count} robots that are farthest from their goals` : "");
  }

  show(seen, chosen) {
    const { swarm } = this;
    if (!swarm || seen.swarm !== swarm) return;
    const order = Array.from({ length: swarm.count }, (_, row) => row), far = (row) => seen.errors?.[row] ?? -1;
    if (swarm.count > ROWS) order.sort((a, b) => far(b) - far(a));
    this.rows.forEach((line, place) => {
      const row = order[place], robot = swarm.robots[row], error = seen.errors?.[row];
      const marks = [];
      if (seen.stuck.has(robot.id)) marks.push("stuck");
      if (seen.poses && seen.poses[3 * row] == null) marks.push("out of sight");
      if (robot.calibrated) marks.push("calibrated");
      const key = `${row}|${seen.group}|${error == null ? "" : error.toFixed(1)}|${marks}|${row === chosen}`;
      if (line.key === key) return;
      const isNew = line.robot !== row || line.group !== seen.group;
      Object.assign(line, { key, robot: row, group: seen.group });
      if (isNew) {
        line.cells[0].textContent = `${robot.id}`;
        line.line.style.setProperty("--own", swarm.colour(row));
        line.line.style.setProperty("--fill", seen.group !== null && swarm.isMember(row, seen.group) ? swarm.colour(row) : "transparent");
        line.cells[1].replaceChildren(...[...robot.word].map((bit, k) => {
          if (k + 1 !== seen.group) return bit;
          const lit = document.createElement("b");
          lit.textContent = bit;
          return lit;
        }));
      }
      line.cells[2].textContent = error == null ? "" : error < 100 ? error.toFixed(1) : error.toFixed(0);
      line.cells[3].textContent = marks.join(", ");
      line.line.classList.toggle("chosen", row === chosen);
    });
  }
}

function showSaid(said) {
  byId("said").replaceChildren(...[...said].reverse().map((line) => {
    const item = document.createElement("li");
    item.textContent = line;
    return item;
  }));
}
