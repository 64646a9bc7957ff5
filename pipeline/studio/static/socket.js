// The socket: binary frames in, one JSON object per message out; reconnects automatically.

const TYPES = { f4: Float32Array, i4: Int32Array, u1: Uint8Array };
const TEXT = new TextDecoder();

async function inflated(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
  return new Response(stream).arrayBuffer();
}

/** A message as `{header, blobs: {name: typed array}}`: length, JSON, padding to 4, blobs. */
export async function decode(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(TEXT.decode(new Uint8Array(buffer, 4, length)));
  const first = (4 + length + 3) & ~3;
  const blobs = {};
  for (const { name, dtype, shape, at, zip, size } of header.blobs ?? []) {
    const count = shape.reduce((a, b) => a * b, 1);
    blobs[name] = zip
      ? new TYPES[dtype](await inflated(new Uint8Array(buffer, first + at, size)))
      : new TYPES[dtype](buffer, first + at, count);
  }
  return { header, blobs };
}

/** Keeps a socket open. `take(header, blobs)` gets each message in order, `tell(open, reason, after)` the connection's state. */
export class Connection {
  constructor(take, tell) {
    this.take = take;
    this.tell = tell;
    this.open();
  }

  open() {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = new WebSocket(`${scheme}://${location.host}/socket${location.search}`);
    let queue = Promise.resolve(), reason = "", after = [];
    socket.binaryType = "arraybuffer";
    socket.onmessage = ({ data }) => {
      queue = queue.then(async () => {
        const { header, blobs } = await decode(data);
        if (header.kind === "bye") ({ reason, after } = header);
        else this.take(header, blobs);
      }).catch((error) => console.error(error));
    };
    socket.onopen = () => { this.wait = 500; this.tell(true, ""); };
    socket.onclose = () => queue.finally(() => {
      this.tell(false, reason, after);
      // After a goodbye the server is gone; anything else is a lost connection, a sleep or a restart.
      if (!reason) setTimeout(() => this.open(), this.wait = Math.min(2 * (this.wait ?? 250), 4000));
    });
    this.socket = socket;
  }

  /** Send one input; false when not connected. */
  send(message) {
    if (this.socket.readyState !== WebSocket.OPEN) return false;
    this.socket.send(JSON.stringify(message));
    return true;
  }
}
