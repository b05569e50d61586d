// The connections to the server: one for what happens, one for stop alone, so that a stop waits for nothing.

const WRONG_TOKEN = 4403, RETRY = 1000;

class Link {
  constructor(onMessage, onState) {
    this.onMessage = onMessage;
    this.onState = onState; // called with "open", "lost" or "refused"
    this.token = location.hash.slice(1);
    this.connect();
    this.connectStop();
  }

  open(path) { return new WebSocket(`ws://${location.host}${path}`); }

  connect() {
    const socket = this.events = this.open("/events");
    socket.onopen = () => socket.send(JSON.stringify({ hello: this.token }));
    socket.onmessage = ({ data }) => {
      const { kind, is } = JSON.parse(data);
      this.onMessage(kind, is);
      if (kind === "role") this.onState("open");
    };
    socket.onclose = ({ code }) => {
      this.onState(code === WRONG_TOKEN ? "refused" : "lost");
      if (code !== WRONG_TOKEN) setTimeout(() => this.connect(), RETRY);
    };
  }

  connectStop() {
    const socket = this.line = this.open("/stop");
    socket.onclose = () => setTimeout(() => this.connectStop(), RETRY);
  }

  ask(ask, more = {}) {
    if (this.events.readyState === WebSocket.OPEN) this.events.send(JSON.stringify({ ask, ...more }));
  }

  // True if it is on its way.
  stop() {
    for (const socket of [this.line, this.events]) {
      if (socket.readyState === WebSocket.OPEN) {
        socket.send('{"ask":"stop"}');
        return true;
      }
    }
    return false;
  }
}
