// The voltage on the substrate: all segments of an epoch are wide enough to be read, drives are cut short.

const WIDE = { reset: 24, rest: 7, symbol: 20, drive: 132 }; // pixels

class Volts {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    new ResizeObserver(() => { this.fit(); this.onResize?.(); }).observe(canvas);
    this.fit();
  }

  fit() {
    this.ratio = Math.min(window.devicePixelRatio || 1, 2);
    this.canvas.width = Math.round(this.canvas.clientWidth * this.ratio);
    this.canvas.height = Math.round(this.canvas.clientHeight * this.ratio);
  }

  // Draw around a time of a motion; without one, the level that is said.
  draw(swarm, motion, time, level) {
    const context = this.context, r = this.ratio, width = this.canvas.width / r, height = this.canvas.height / r;
    context.setTransform(r, 0, 0, r, 0, 0);
    context.clearRect(0, 0, width, height);
    if (!swarm) return;
    const { rest, drive, pulses } = swarm.volts, low = pulses?.alternating ? -drive : Math.min(rest, 0);
    const y = (volts) => height - 22 - (height - 46) * (volts - low) / (drive - low);
    context.font = "11px system-ui, sans-serif";
    context.fillStyle = "#5b6675";
    context.textAlign = "right";
    for (const volts of new Set([low, rest, drive])) {
      context.fillText(`${+volts.toPrecision(4)} V`, 42, y(volts) + 4);
      context.strokeStyle = "#e9edf2";
      context.beginPath(); context.moveTo(46, y(volts)); context.lineTo(width, y(volts)); context.stroke();
    }
    context.save();
    context.beginPath(); context.rect(46, 0, width - 46, height); context.clip();
    if (motion && motion.count) this.trace(swarm, motion, time, y, width, height);
    else {
      context.strokeStyle = "#1f4e8c"; context.lineWidth = 2;
      context.beginPath(); context.moveTo(46, y(level)); context.lineTo(width, y(level)); context.stroke();
      context.textAlign = "left"; context.fillStyle = "#5b6675";
      context.fillText(`${+level.toPrecision(4)} V now; the epochs are shown once a plan is heard`, 54, height - 6);
    }
    context.restore();
  }

  trace(swarm, motion, time, y, width, height) {
    const context = this.context, now = motion.segment(time), at = 46 + 0.4 * (width - 46);
    const epochWide = motion.segments(0).reduce((wide, [, , , kind]) => wide + WIDE[kind], 0);
    const middle = now.k < motion.count ? now.k : motion.count - 1;
    let inside = 0; // pixels of the present epoch that are over
    if (now.k === motion.count) inside = epochWide;
    else motion.segments(middle).forEach(([, , , kind], s) => { inside += s < now.s ? WIDE[kind] : s === now.s ? WIDE[kind] * now.share : 0; });
    const first = Math.max(0, middle - Math.ceil(at / epochWide)), last = Math.min(motion.count - 1, middle + Math.ceil(width / epochWide));
    const line = [];
    for (let k = first; k <= last; k++) {
      let x = at - inside + (k - middle) * epochWide;
      const left = x;
      context.fillStyle = k === now.k ? "#fff6dd" : k % 2 ? "#f8f9fb" : "#eef3f9";
      context.fillRect(left, 0, epochWide, height);
      motion.segments(k).forEach(([level, dwell, label, kind]) => {
        const wide = WIDE[kind];
        line.push([x, y(level)], [x + wide, y(level)]);
        context.textAlign = "center";
        context.fillStyle = "#1b2430";
        if (kind === "drive") this.drive(swarm, motion, k, level, dwell, label, x, wide, y);
        else if (label) context.fillText(label, x + wide / 2, y(level) + (level < 0 ? 13 : -4));
        x += wide;
      });
      context.fillStyle = "#5b6675";
      context.textAlign = "left";
      context.fillText(`epoch ${k + 1}`, left + 4, height - 6);
    }
    context.strokeStyle = "#1f4e8c";
    context.lineWidth = 1.8;
    context.beginPath();
    line.forEach(([x, py]) => context.lineTo(x, py));
    context.stroke();
    context.strokeStyle = "#d55e00";
    context.lineWidth = 2;
    context.beginPath(); context.moveTo(at, 0); context.lineTo(at, height); context.stroke();
  }

  drive(swarm, motion, k, level, dwell, label, x, wide, y) {
    const context = this.context, pulses = swarm.volts.pulses;
    const text = `${label} ${timeText(dwell)}${pulses ? `, ${motion.pulses[k]} pulses` : ""}`;
    if (pulses) {
      const sign = Math.sign(level), lows = pulses.alternating ? -level : sign * pulses.low;
      context.fillStyle = "#1f4e8c55";
      context.fillRect(x, Math.min(y(level), y(lows)), wide, Math.abs(y(level) - y(lows)));
      context.fillStyle = "#1b2430";
    }
    context.font = "600 11px system-ui, sans-serif";
    context.fillText(text, x + wide / 2, y(Math.abs(level)) - 5, wide + 30);
    context.font = "11px system-ui, sans-serif";
  }
}
