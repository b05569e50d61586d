// A swarm and its motions in closed form, as stressbot_planner's model.kinematics and sequencing: µm, s, rad, volts.

class Swarm {
  constructor(scene) {
    Object.assign(this, scene);
    this.count = scene.robots.length;
    this.rowOf = new Map(scene.robots.map((robot, row) => [robot.id, row]));
    this.groups = scene.robots[0].word.length + 1;
    const volts = scene.volts;
    this.before = volts.byLevel
      ? volts.guardDwell + volts.symbolDwell
      : volts.resetDwell + volts.guardDwell + volts.codes[0].length * (volts.symbolDwell + volts.guardDwell);
  }

  isMember(row, group) { return this.robots[row].word[group - 1] === "1"; }

  members(group) { return this.robots.filter((robot) => robot.word[group - 1] === "1").map((robot) => robot.id); }

  colour(row) { return this.colours[row % this.colours.length]; }

  // As palette.style: colours come again with other lines, and after those hollow.
  lines(row) { return [[], [8, 3], [2, 2.5], [9, 3, 2, 3]][Math.floor(row / this.colours.length) % 4]; }

  isFilled(row) { return Math.floor(row / this.colours.length / 4) % 2 === 0; }
}

class Motion {
  static KNOTS = 3e6; // numbers that are kept

  constructor(swarm, data) {
    Object.assign(this, data);
    this.swarm = swarm;
    this.count = data.groups.length;
    const drive = swarm.volts.pulses;
    this.pulses = drive && data.lengths.map((length) => Math.round(length * drive.frequency / swarm.speed));
    this.drives = data.lengths.map((length, k) => drive ? this.pulses[k] / drive.frequency : length / swarm.speed);
    this.begins = new Float64Array(this.count + 1);
    for (let k = 0; k < this.count; k++) {
      this.begins[k + 1] = this.begins[k] + swarm.before + this.drives[k] + swarm.volts.guardDwell;
    }
    this.duration = this.begins[this.count];
    this.stride = Math.max(1, Math.ceil(this.count * swarm.count * 3 / Motion.KNOTS));
    this.checkpoints = [Float64Array.from(data.starts.flat())];
    this.at = { k: 0, poses: this.checkpoints[0] };
  }

  // Poses, three numbers a robot, after an activation of a group that is so long.
  advanced(poses, group, length) {
    const next = Float64Array.from(poses);
    this.swarm.robots.forEach((robot, row) => {
      const at = 3 * row, way = length * robot.pace;
      if (robot.word[group - 1] === "1") {
        next[at] += way * Math.cos(next[at + 2]);
        next[at + 1] += way * Math.sin(next[at + 2]);
      } else next[at + 2] += way / robot.turning;
    });
    return next;
  }

  // Poses before activation k, counted from 0.
  knot(k) {
    let from = Math.min(Math.floor(k / this.stride), this.checkpoints.length - 1) * this.stride;
    let poses = this.checkpoints[from / this.stride];
    if (this.at.k <= k && this.at.k > from) ({ k: from, poses } = this.at);
    for (; from < k; from++) {
      poses = this.advanced(poses, this.groups[from], this.lengths[from]);
      if ((from + 1) % this.stride === 0 && this.checkpoints.length === (from + 1) / this.stride) this.checkpoints.push(poses);
    }
    this.at = { k, poses };
    return poses;
  }

  // Where a time lies: the epoch, counted from 0, and the share of its drive that is over.
  place(time) {
    if (this.count === 0) return { k: 0, share: 0 };
    let low = 0, high = this.count - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (this.begins[middle] <= time) low = middle; else high = middle - 1;
    }
    const driven = time - this.begins[low] - this.swarm.before;
    return { k: low, share: Math.min(Math.max(driven / this.drives[low], 0), 1) };
  }

  poses(time) {
    const { k, share } = this.place(time);
    const poses = this.knot(k);
    return share > 0 ? this.advanced(poses, this.groups[k], share * this.lengths[k]) : poses;
  }

  // Level, dwell, label and kind of each segment of an epoch.
  segments(k) {
    const volts = this.swarm.volts, rest = [volts.rest, volts.guardDwell, "", "rest"], sign = this.signs ? this.signs[k] : 1;
    const group = this.groups[k], segments = volts.byLevel ? [rest] : [[sign * volts.reset, volts.resetDwell, "R", "reset"], rest];
    for (const symbol of volts.codes[group - 1]) {
      segments.push([sign * volts.symbols[symbol], volts.symbolDwell, `${symbol}`, "symbol"]);
      if (!volts.byLevel) segments.push(rest);
    }
    segments.push([sign * volts.drive, this.drives[k], `G${group}`, "drive"], rest);
    return segments;
  }

  // The segment of a time: its epoch, place in it, level and kind, and the share of it that is over.
  segment(time) {
    if (this.count === 0 || time >= this.duration) return { k: this.count, s: 0, share: 0, level: this.swarm.volts.rest, kind: "rest" };
    const { k } = this.place(time);
    let left = time - this.begins[k];
    const segments = this.segments(k);
    for (let s = 0; s < segments.length; s++) {
      if (left < segments[s][1] || s === segments.length - 1) {
        return { k, s, share: Math.min(left / segments[s][1], 1), level: segments[s][0], kind: segments[s][3] };
      }
      left -= segments[s][1];
    }
  }
}

// A length in words.
function lengthText(um) {
  return um >= 1e4 ? `${+(um / 1e3).toPrecision(3)} mm` : um >= 1 ? `${+um.toPrecision(3)} µm` : `${+(um * 1e3).toPrecision(3)} nm`;
}

function timeText(seconds) {
  if (!(seconds >= 0)) return "";
  const whole = Math.floor(seconds), two = (n) => String(n).padStart(2, "0");
  return seconds < 60 ? `${seconds.toFixed(1)} s`
    : seconds < 3600 ? `${Math.floor(whole / 60)}:${two(whole % 60)} min`
    : `${Math.floor(whole / 3600)}:${two(Math.floor(whole / 60) % 60)}:${two(whole % 60)} h`;
}
