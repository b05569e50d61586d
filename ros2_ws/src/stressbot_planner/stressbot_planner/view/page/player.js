// The timeline of a plan or a recording.

const SPEEDS = [0.25, 0.5, 1, 2, 5, 10, 20, 50, 100, 500];
const TOLD = 100; // ms from one change of slider and clock to the next while something plays

class Player {
  constructor(onTime) {
    this.onTime = onTime;
    this.time = 0;
    this.duration = 0;
    this.isPlaying = false;
    for (const speed of SPEEDS) byId("speed").add(new Option(`${speed} ×`, speed));
    byId("play").addEventListener("click", () => this.toggle());
    byId("time").addEventListener("input", () => this.seek(+byId("time").value));
    document.addEventListener("keydown", (event) => {
      if (!this.duration || event.ctrlKey || event.altKey || event.metaKey || /^(SELECT|INPUT|BUTTON)$/.test(event.target.tagName)) return;
      const step = { ",": -1, ".": 1 }[event.key];
      if (event.key === " ") this.toggle();
      else if (step) this.seek(this.time + step * this.duration / 200);
      else if (event.key === "Home") this.seek(0);
      else if (event.key === "End") this.seek(this.duration);
      else return;
      event.preventDefault();
    });
  }

  load(duration) {
    this.duration = duration;
    byId("time").max = duration;
    setHidden("timeline", false);
    byId("speed").value = SPEEDS.find((speed) => duration / speed <= 30) ?? SPEEDS.at(-1);
    this.seek(0);
  }

  toggle() {
    this.isPlaying = !this.isPlaying;
    if (this.isPlaying && this.time >= this.duration) this.seek(0);
    byId("play").textContent = this.isPlaying ? "❚❚" : "▶";
    this.before = null;
    if (this.isPlaying) requestAnimationFrame((now) => this.step(now));
  }

  step(now) {
    if (!this.isPlaying) return;
    if (this.before !== null) this.seek(this.time + (now - this.before) / 1000 * +byId("speed").value);
    this.before = now;
    if (this.time >= this.duration) this.toggle(); else requestAnimationFrame((next) => this.step(next));
  }

  seek(time) {
    this.time = Math.min(Math.max(time, 0), this.duration);
    this.onTime(this.time);
    const now = performance.now();
    if (this.isPlaying && this.time < this.duration && now < this.told + TOLD) return;
    this.told = now;
    byId("time").value = this.time;
    setText("clock", `${timeText(this.time)} / ${timeText(this.duration)}`);
  }
}

// Contents by kind and time, as they were recorded; `at` puts those of a time in force.
class Recorded {
  constructor(kinds, apply) {
    this.kinds = kinds; // { kind: { times, contents } }
    this.apply = apply;
    this.shown = {};
  }

  index(kind, time) {
    const { times } = this.kinds[kind];
    let low = -1, high = times.length - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (times[middle] <= time) low = middle; else high = middle - 1;
    }
    return low;
  }

  at(time) {
    for (const kind of Object.keys(this.kinds)) {
      const index = this.index(kind, time);
      if (index === this.shown[kind]) continue;
      this.shown[kind] = index;
      this.apply(kind, index < 0 ? null : this.kinds[kind].contents[index]);
    }
  }
}
