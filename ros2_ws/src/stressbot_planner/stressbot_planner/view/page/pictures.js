// What the camera sees: a connection of its own, as long as somebody wants it.

const PLACE = 48; // bytes before the JPEG: six doubles, from pixels to µm
const OLD = 2000; // ms after which a picture that no other has followed is shown no more

class Pictures {
  constructor(box, onPicture) {
    this.box = box;
    this.onPicture = onPicture; // called with { image, place }, or null
    this.count = 0;
    box.addEventListener("change", () => this.turn());
  }

  turn() {
    this.socket?.close();
    this.socket = null;
    this.show(null);
    if (this.box.checked) this.connect();
  }

  connect() {
    const socket = this.socket = new WebSocket(`ws://${location.host}/pictures`);
    socket.binaryType = "arraybuffer";
    socket.onmessage = async ({ data }) => {
      const image = await createImageBitmap(new Blob([new Uint8Array(data, PLACE)], { type: "image/jpeg" }));
      if (socket === this.socket) this.show({ image, place: new Float64Array(data, 0, 6) }); else image.close();
    };
    socket.onclose = () => setTimeout(() => { if (socket === this.socket) this.turn(); }, RETRY);
  }

  show(picture) {
    clearTimeout(this.timer);
    if (picture) { this.count++; this.timer = setTimeout(() => this.show(null), OLD); }
    const before = this.shown;
    this.shown = picture;
    this.onPicture(picture);
    before?.image.close();
  }
}
