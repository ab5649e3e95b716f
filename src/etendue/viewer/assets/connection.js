// The WebSocket of a page: messages as protocol.py describes them. Reconnects when the connection breaks.

export class Connection {
  constructor(onStatus) {
    this.listeners = new Map();
    this.onStatus = onStatus;
    this.ended = false;
    this.wait = 500;
    this.open();
  }

  open() {
    const url = new URL('socket', location.href);
    url.protocol = url.protocol === 'https:' ? 'wss:' : 'ws:';
    this.socket = new WebSocket(url);
    this.socket.binaryType = 'arraybuffer';
    this.socket.onopen = () => { this.wait = 500; this.onStatus('open'); };
    this.socket.onmessage = (event) => this.take(event.data);
    this.socket.onclose = (event) => {
      if (event.code === 1001 && !this.ended) this.end(event.reason); // the server has gone, and its token with it
      if (this.ended) return;
      this.onStatus('closed');
      setTimeout(() => this.open(), this.wait);
      this.wait = Math.min(this.wait * 2, 10000);
    };
  }

  end(why = '') {
    this.ended = true;
    this.onStatus('ended', why);
  }

  on(type, listener) {
    this.listeners.set(type, [...(this.listeners.get(type) ?? []), listener]);
  }

  send(type, data = {}) {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify({ ...data, type }));
  }

  take(data) {
    let message;
    let view = new DataView(new ArrayBuffer(0));
    if (typeof data === 'string') {
      message = JSON.parse(data);
    } else {
      const length = new DataView(data).getUint32(0, true);
      message = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
      view = new DataView(data, 4 + length);
    }
    for (const listener of this.listeners.get(message.type) ?? []) listener(message, view);
  }
}
