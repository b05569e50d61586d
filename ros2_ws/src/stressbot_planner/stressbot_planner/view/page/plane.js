// The substrate from above: what rests is drawn on one canvas and seldom, robots and goals on another and often.

const INK = "#1b2430", PAPER = "#ffffff", FAINT = "#e9edf2";
const SEGMENTS = 12000; // of lines ahead, and of trails, at most: a large swarm is drawn as often as a small one
const NAMED = 150, FEW = 30; // robots that all have their id written, also at their goals
const REDRAW = 200, REDRAW_LARGE = 1000; // ms from one drawing of the ground to the next, of up to NAMED robots and of more

class Plane {
  constructor(ground, swarm, hint, onGoal) {
    this.canvases = [ground, swarm];
    [this.ground, this.top] = this.canvases.map((canvas) => canvas.getContext("2d"));
    this.hint = hint;
    this.onGoal = onGoal; // called with a row, x and y; null: goals stay
    this.goals = () => this.seen.goals; // as they are now
    this.zoom = 1;
    this.shift = [0, 0];
    this.chosen = null; // row
    this.picture = null; // { image, place } of the camera
    this.grounded = -Infinity;
    this.frames = 0;
    this.listen(swarm);
    new ResizeObserver(() => this.resize()).observe(swarm);
  }

  // What is shown; swarm is null where there is none.
  show(seen) {
    const isNew = seen.swarm !== this.seen?.swarm;
    const isRoute = isNew || seen.motion !== this.seen?.motion;
    this.seen = seen;
    if (isNew) { this.zoom = 1; this.shift = [0, 0]; this.chosen = null; }
    if (isRoute) { this.bounds = seen.swarm && this.extent(); this.stale(); }
  }

  stale() { this.grounded = -Infinity; }

  resize() {
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    for (const canvas of this.canvases) {
      canvas.width = Math.round(canvas.clientWidth * ratio);
      canvas.height = Math.round(canvas.clientHeight * ratio);
    }
    this.ratio = ratio;
    this.stale();
    this.onResize?.();
  }

  // Places: µm to pixels and back.

  extent() {
    const { swarm, motion } = this.seen, box = [Infinity, Infinity, -Infinity, -Infinity];
    const add = (x, y, around = 0) => {
      box[0] = Math.min(box[0], x - around); box[1] = Math.min(box[1], y - around);
      box[2] = Math.max(box[2], x + around); box[3] = Math.max(box[3], y + around);
    };
    const body = Math.max(...swarm.icons) * 0.6;
    const waypoints = swarm.robots.flatMap((robot) => robot.waypoints);
    for (const [x, y] of [...swarm.starts, ...swarm.goals, ...waypoints, ...(motion?.goals ?? [])]) add(x, y, body);
    for (const { circle, polygon } of swarm.obstacles) {
      if (circle) add(circle[0], circle[1], circle[2]); else polygon.forEach(([x, y]) => add(x, y));
    }
    if (swarm.walls) { const [[x0, x1], [y0, y1]] = swarm.walls; add(x0, y0, 20); add(x1, y1, 20); }
    if (motion && motion.count) {
      const step = Math.max(1, Math.floor(motion.count / 200));
      for (let k = 0; k <= motion.count; k += step) {
        const poses = motion.knot(k);
        for (let at = 0; at < poses.length; at += 3) add(poses[at], poses[at + 1], body);
      }
    }
    return box;
  }

  measure() {
    const [x0, y0, x1, y1] = this.bounds, { width, height } = this.canvases[1];
    const room = 34 * this.ratio;
    this.scale = this.zoom * Math.min((width - 2 * room) / (x1 - x0 || 1), (height - 2 * room) / (y1 - y0 || 1));
    this.origin = [width / 2 - this.scale * ((x0 + x1) / 2 - this.shift[0]), height / 2 + this.scale * ((y0 + y1) / 2 - this.shift[1])];
  }

  x(um) { return this.origin[0] + this.scale * um; }
  y(um) { return this.origin[1] - this.scale * um; }
  um(px, py) { return [(px - this.origin[0]) / this.scale, (this.origin[1] - py) / this.scale]; }

  // Of a robot, in pixels: to scale, but never too small to be seen.
  length(row) { return Math.max(this.scale * this.seen.swarm.icons[row], 6 * this.ratio); }

  // Drawing

  // Returns whether the ground was drawn too, which is done seldom.
  draw(now) {
    const { width, height } = this.canvases[1];
    this.frames++;
    this.top.clearRect(0, 0, width, height);
    if (!this.seen?.swarm || !width) {
      this.ground.clearRect(0, 0, width, height);
      return true;
    }
    this.measure();
    const isDue = now > this.grounded + (this.seen.swarm.count > NAMED ? REDRAW_LARGE : REDRAW);
    const isLarge = this.seen.swarm.count > NAMED;
    if (isDue) { this.grounded = now; this.drawGround(); if (isLarge) this.drawGoals(this.ground); }
    if (!isLarge) this.drawGoals(this.top);
    this.drawRobots();
    return isDue;
  }

  drawGround() {
    const context = this.ground, { width, height } = context.canvas, { swarm } = this.seen;
    context.clearRect(0, 0, width, height);
    if (this.picture) this.drawPicture(context); else this.drawGrid(context);
    context.fillStyle = this.picture ? "#3c465480" : "#3c4654";
    for (const { circle, polygon } of swarm.obstacles) {
      context.beginPath();
      if (circle) context.arc(this.x(circle[0]), this.y(circle[1]), this.scale * circle[2], 0, 2 * Math.PI);
      else polygon.forEach(([x, y]) => context.lineTo(this.x(x), this.y(y)));
      context.fill();
    }
    if (swarm.walls) {
      const [[x0, x1], [y0, y1]] = swarm.walls;
      context.strokeStyle = INK;
      context.lineWidth = 2.5 * this.ratio;
      context.strokeRect(this.x(x0), this.y(y1), this.scale * (x1 - x0), this.scale * (y1 - y0));
    }
    this.drawAhead(context);
    this.drawTrail(context);
    this.drawBar(context);
  }

  // Pixels have their middle at whole numbers.
  drawPicture(context) {
    const { image, place: [a, b, x, c, d, y] } = this.picture, k = this.scale;
    context.save();
    context.setTransform(k * a, -k * c, k * b, -k * d, this.x(x), this.y(y));
    context.drawImage(image, -0.5, -0.5);
    context.restore();
  }

  // A round number of µm that is about so many pixels long.
  round(pixels) {
    const um = pixels / this.scale, power = 10 ** Math.floor(Math.log10(um));
    return power * [1, 2, 5].filter((step) => step * power <= um * 1.000001).pop();
  }

  drawGrid(context) {
    const { width, height } = context.canvas, step = this.round(110 * this.ratio);
    const [x0, y1] = this.um(0, 0), [x1, y0] = this.um(width, height);
    context.strokeStyle = FAINT;
    context.lineWidth = this.ratio;
    context.beginPath();
    for (let x = Math.ceil(x0 / step) * step; x < x1; x += step) { context.moveTo(this.x(x), 0); context.lineTo(this.x(x), height); }
    for (let y = Math.ceil(y0 / step) * step; y < y1; y += step) { context.moveTo(0, this.y(y)); context.lineTo(width, this.y(y)); }
    context.stroke();
  }

  drawBar(context) {
    const um = this.round(160 * this.ratio), length = um * this.scale, ratio = this.ratio;
    const x = 16 * ratio, y = context.canvas.height - 16 * ratio;
    context.fillStyle = "#ffffffcc";
    context.fillRect(x - 6 * ratio, y - 24 * ratio, length + 12 * ratio, 34 * ratio);
    context.fillStyle = INK;
    context.fillRect(x, y - 2 * ratio, length, 4 * ratio);
    context.font = `600 ${13 * ratio}px system-ui, sans-serif`;
    context.textAlign = "center";
    context.fillText(lengthText(um), x + length / 2, y - 8 * ratio);
  }

  line(context, row, width, alpha) {
    const { swarm } = this.seen;
    context.strokeStyle = swarm.colour(row);
    context.globalAlpha = alpha;
    context.lineWidth = (swarm.count > NAMED ? 0.6 * width : width) * this.ratio;
    context.setLineDash(swarm.count > NAMED ? [] : swarm.lines(row).map((part) => part * this.ratio));
    context.lineJoin = "round";
  }

  plain(context) { context.globalAlpha = 1; context.setLineDash([]); }

  drawAhead(context) {
    const { swarm, motion, time } = this.seen;
    if (!motion || !motion.count || time >= motion.duration) return;
    const first = motion.place(time).k + 1, most = Math.max(2, Math.floor(SEGMENTS / swarm.count));
    const knots = [this.seen.poses ?? motion.poses(time)];
    for (let k = first; k <= motion.count && knots.length < most; k++) knots.push(motion.knot(k));
    for (let row = 0; row < swarm.count; row++) {
      this.line(context, row, 1.5, 0.6);
      context.beginPath();
      this.path(context, knots, 3, row);
      context.stroke();
    }
    this.plain(context);
  }

  drawTrail(context) {
    const { swarm, trail } = this.seen;
    if (!trail || !trail.rows.length) return;
    const rows = trail.rows.slice(-Math.max(2, Math.floor(SEGMENTS / swarm.count))); // of many robots the last stretch
    for (let row = 0; row < swarm.count; row++) {
      this.line(context, row, 2.6, 0.8);
      context.setLineDash([]);
      context.beginPath();
      this.path(context, rows, trail.width, row);
      context.stroke();
    }
    this.plain(context);
  }

  // A line through a robot's places, without those that are less than a pixel apart.
  path(context, rows, width, row) {
    let px = NaN, py = NaN, isDown = false;
    for (const places of rows) {
      const ux = places[width * row], uy = places[width * row + 1];
      if (ux == null || Number.isNaN(ux)) { isDown = false; continue; }
      const x = this.x(ux), y = this.y(uy);
      if (!isDown) context.moveTo(x, y); else if (Math.abs(x - px) + Math.abs(y - py) >= 1) context.lineTo(x, y); else continue;
      px = x; py = y; isDown = true;
    }
    if (isDown) context.lineTo(px, py);
  }

  drawGoals(context) {
    const { swarm, goals, errors } = this.seen, r = this.ratio;
    const size = Math.max(Math.min(this.scale * 22, 7 * r), (swarm.count > NAMED ? 2 : 4) * r);
    for (let colour = 0; colour < Math.min(swarm.colours.length, swarm.count); colour++) {
      context.strokeStyle = swarm.colours[colour];
      context.lineWidth = (swarm.count > NAMED ? 1.3 : 2.2) * r;
      context.beginPath();
      for (let row = colour; row < swarm.count; row += swarm.colours.length) {
        const x = this.x(goals[row][0]), y = this.y(goals[row][1]), { parked, waypoints, goalHeading: look } = swarm.robots[row];
        if (parked) {
          const half = Math.max(size, 0.7 * this.length(row));
          context.rect(x - half, y - half, 2 * half, 2 * half);
          continue;
        }
        context.moveTo(x - size, y - size); context.lineTo(x + size, y + size);
        context.moveTo(x - size, y + size); context.lineTo(x + size, y - size);
        for (const [wx, wy] of waypoints) this.plus(context, this.x(wx), this.y(wy), size);
        if (look != null) { context.moveTo(x, y); context.lineTo(x + 3.5 * size * Math.cos(look), y - 3.5 * size * Math.sin(look)); }
        if (errors?.[row] <= 2) { context.moveTo(x + 1.7 * size, y); context.arc(x, y, 1.7 * size, 0, 2 * Math.PI); }
      }
      context.stroke();
    }
    this.drawContacts(context, goals);
    if (this.chosen !== null && goals[this.chosen]) {
      const [x, y] = goals[this.chosen];
      context.strokeStyle = INK;
      context.lineWidth = 2 * r;
      context.beginPath();
      context.arc(this.x(x), this.y(y), size + 7 * r, 0, 2 * Math.PI);
      context.stroke();
    }
    if (swarm.count > FEW) return;
    goals.forEach(([x, y], row) => {
      if (!swarm.robots[row].parked) this.name(row, this.x(x) + size + 7 * r, this.y(y) - size - 4 * r, 11);
    });
  }

  plus(context, x, y, size) {
    context.moveTo(x - size, y); context.lineTo(x + size, y);
    context.moveTo(x, y - size); context.lineTo(x, y + size);
  }

  drawContacts(context, goals) {
    context.strokeStyle = "#4d4d4d99";
    context.lineWidth = 3 * this.ratio;
    context.beginPath();
    for (const [one, other] of this.seen.swarm.contacts) {
      context.moveTo(this.x(goals[one][0]), this.y(goals[one][1]));
      context.lineTo(this.x(goals[other][0]), this.y(goals[other][1]));
    }
    context.stroke();
  }

  drawRobots() {
    const { swarm, poses, group, isDown } = this.seen;
    if (!poses) return;
    for (let first = 0; first < Math.min(swarm.colours.length, swarm.count); first++) {
      for (const isLit of [false, true]) {
        this.bodies(first, (row) => (group !== null && swarm.isMember(row, group)) === isLit, isLit);
      }
    }
    this.arms(isDown);
    this.marks();
    if (swarm.count <= NAMED || this.scale * Math.max(...swarm.icons) > 30 * this.ratio) {
      for (let row = 0; row < swarm.count; row++) {
        if (!(poses[3 * row] == null)) {
          const away = 0.42 * this.length(row) + 9 * this.ratio;
          this.name(row, this.x(poses[3 * row]), this.y(poses[3 * row + 1]) + away + 4 * this.ratio, swarm.count > FEW ? 10 : 12);
        }
      }
    }
  }

  // Outlines of the robots of one colour for which `picks` holds; those of the active group are filled and larger in line.
  bodies(first, picks, isLit) {
    const context = this.top, { swarm, poses } = this.seen, step = swarm.colours.length, isSmall = this.length(first) < 14 * this.ratio;
    context.beginPath();
    for (let row = first; row < swarm.count; row += step) {
      const x = poses[3 * row];
      if (x == null || !picks(row)) continue;
      const heading = poses[3 * row + 2], length = this.length(row), c = length * Math.cos(heading), s = length * Math.sin(heading);
      const px = this.x(x), py = this.y(poses[3 * row + 1]);
      swarm.outline.forEach(([u, v], k) => {
        const qx = px + u * c - v * s, qy = py - u * s - v * c;
        if (k) context.lineTo(qx, qy); else context.moveTo(qx, qy);
      });
      if (!isSmall) { context.moveTo(px, py); context.lineTo(px + 0.5 * c, py - 0.5 * s); }
    }
    const colour = swarm.colours[first];
    if (isSmall) {
      context.globalAlpha = isLit ? 1 : 0.45;
      context.fillStyle = colour;
      context.fill();
      context.globalAlpha = 1;
      if (!isLit) return;
    }
    if (isLit && swarm.count <= NAMED) {
      context.lineWidth = Math.min(9 * this.ratio, 0.4 * this.length(first));
      context.strokeStyle = "#f0e442"; // the yellow of Okabe and Ito, as a glow
      context.globalAlpha = 0.75;
      context.stroke();
    }
    context.globalAlpha = this.picture ? (isLit ? 0.4 : 0) : isLit ? 1 : 0.9; // what the camera sees of it stays to be seen
    context.fillStyle = isLit ? colour : PAPER;
    context.fill();
    context.globalAlpha = 1;
    context.lineWidth = (swarm.count > NAMED ? 1 : 1.8) * this.ratio;
    context.strokeStyle = isLit ? INK : colour;
    context.stroke();
  }

  // An arm is drawn at the left side, about which a robot turns when it is down: a dot; up: a ring.
  arms(isDown) {
    const context = this.top, { swarm, poses, group } = this.seen;
    for (const down of [false, true]) {
      context.beginPath();
      for (let row = 0; row < swarm.count; row++) {
        const x = poses[3 * row], length = this.length(row);
        if (x == null || length < 12 * this.ratio || (isDown && !(group !== null && swarm.isMember(row, group))) !== down) continue;
        const heading = poses[3 * row + 2], c = length * Math.cos(heading), s = length * Math.sin(heading), r = 0.085 * length;
        const px = this.x(x), py = this.y(poses[3 * row + 1]);
        const ax = px - 0.12 * c - 0.42 * s, ay = py + 0.12 * s - 0.42 * c;
        context.moveTo(px - 0.12 * c - 0.25 * s, py + 0.12 * s - 0.25 * c);
        context.lineTo(ax, ay);
        context.moveTo(ax + r, ay);
        context.arc(ax, ay, r, 0, 2 * Math.PI);
      }
      context.fillStyle = down ? INK : PAPER;
      context.fill();
      context.strokeStyle = INK;
      context.lineWidth = 1.3 * this.ratio;
      context.stroke();
    }
  }

  // Robots that are stuck have a cross over them, calibrated ones a dot in the middle, those out of sight none of this: a dashed ring.
  marks() {
    const context = this.top, { swarm, poses, stuck, last } = this.seen, r = this.ratio;
    for (let row = 0; row < swarm.count; row++) {
      const isSeen = poses[3 * row] != null, at = isSeen ? poses : last;
      if (!at || at[3 * row] == null) continue;
      const x = this.x(at[3 * row]), y = this.y(at[3 * row + 1]), size = 0.45 * this.length(row);
      if (!isSeen) {
        context.strokeStyle = INK;
        context.lineWidth = 1.5 * r;
        context.setLineDash([4 * r, 4 * r]);
        context.beginPath();
        context.arc(x, y, size, 0, 2 * Math.PI);
        context.stroke();
        context.setLineDash([]);
        continue;
      }
      if (stuck.has(swarm.robots[row].id)) {
        context.lineWidth = 3.5 * r;
        context.strokeStyle = "#000";
        context.beginPath();
        context.moveTo(x - size, y - size); context.lineTo(x + size, y + size);
        context.moveTo(x - size, y + size); context.lineTo(x + size, y - size);
        context.stroke();
      }
      if (swarm.robots[row].calibrated && size > 5 * r) {
        context.fillStyle = PAPER;
        context.strokeStyle = INK;
        context.lineWidth = 1.2 * r;
        context.beginPath();
        context.arc(x, y, 0.13 * size + 1.5 * r, 0, 2 * Math.PI);
        context.fill();
        context.stroke();
      }
    }
  }

  name(row, x, y, size) {
    const context = this.top, text = `${this.seen.swarm.robots[row].id}`;
    context.font = `700 ${size * this.ratio}px system-ui, sans-serif`;
    context.textAlign = "center";
    context.lineWidth = 3.5 * this.ratio;
    context.strokeStyle = "#ffffffdd";
    context.lineJoin = "round";
    context.strokeText(text, x, y);
    context.fillStyle = this.seen.swarm.colour(row);
    context.fillText(text, x, y);
  }

  // Pointer and keys

  listen(canvas) {
    let held = null; // { row } or { at, shift }
    const place = (event) => {
      const box = canvas.getBoundingClientRect();
      return [(event.clientX - box.left) * this.ratio, (event.clientY - box.top) * this.ratio];
    };
    canvas.addEventListener("pointerdown", (event) => {
      if (!this.seen?.swarm) return;
      canvas.setPointerCapture(event.pointerId);
      const [x, y] = place(event), row = this.goalAt(x, y);
      held = row !== null ? { row } : { at: [x, y], shift: [...this.shift] };
      if (row !== null) this.choose(row);
    });
    canvas.addEventListener("pointermove", (event) => {
      const [x, y] = place(event);
      if (!held) {
        canvas.classList.toggle("on-goal", this.goalAt(x, y) !== null);
        return;
      }
      if (held.at) {
        this.shift = [held.shift[0] + (x - held.at[0]) / this.scale, held.shift[1] - (y - held.at[1]) / this.scale];
        this.stale();
        this.onResize?.();
      } else this.onGoal?.(held.row, ...this.um(x, y));
    });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, () => { held = null; });
    canvas.addEventListener("wheel", (event) => { event.preventDefault(); this.magnify(event.deltaY < 0 ? 1.15 : 1 / 1.15); }, { passive: false });
    canvas.addEventListener("keydown", (event) => {
      const { swarm } = this.seen ?? {};
      if (!swarm || event.ctrlKey || event.altKey || event.metaKey) return;
      const turn = { n: 1, p: -1 }[event.key], move = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
      if (turn) this.choose(this.chosen === null ? (turn > 0 ? 0 : swarm.count - 1) : (this.chosen + turn + swarm.count) % swarm.count);
      else if (move && this.chosen !== null) {
        const step = event.shiftKey ? 1 : 10, [x, y] = this.goals()[this.chosen]; // not those drawn last: keys may be faster
        this.onGoal?.(this.chosen, x + step * move[0], y + step * move[1]);
      } else if (event.key === "+") this.magnify(1.25);
      else if (event.key === "-") this.magnify(0.8);
      else if (event.key === "0") this.magnify(0);
      else return;
      event.preventDefault();
    });
  }

  choose(row) {
    this.chosen = row;
    this.onChoose?.(row);
    this.onResize?.();
  }

  goalAt(x, y) {
    if (!this.onGoal || !this.seen?.swarm || !this.origin) return null;
    let best = null, least = 15 * this.ratio;
    this.seen.goals.forEach(([gx, gy], row) => {
      const away = this.seen.swarm.robots[row].parked ? Infinity : Math.hypot(this.x(gx) - x, this.y(gy) - y);
      if (away < least) { best = row; least = away; }
    });
    return best;
  }

  magnify(factor) {
    if (factor) this.zoom = Math.min(Math.max(this.zoom * factor, 0.2), 50); else { this.zoom = 1; this.shift = [0, 0]; }
    this.stale();
    this.onResize?.();
  }
}
