// The live picture: frames from a websocket, painted on a canvas, one per screen refresh, each acknowledged when it is
// painted. A worker does it, so that neither waits for the page's own elements. A frame is 12 bytes, its number, the
// version of the settings and a kind, little-endian, and a JPEG or PNG.
const work = () => {
  let canvas, paper, url;
  const open = () => {
    const socket = new WebSocket(url);
    socket.binaryType = "arraybuffer";
    const ready = []; // promises, so that frames stay in order however long each takes to decode
    const paint = async () => {
      const { bitmap, head } = await ready[0];
      requestAnimationFrame(() => {
        if (bitmap.width !== canvas.width || bitmap.height !== canvas.height) {
          canvas.width = bitmap.width;
          canvas.height = bitmap.height;
        }
        paper.transferFromImageBitmap(bitmap);
        postMessage([performance.timeOrigin + performance.now(), ...head]);
        if (socket.readyState === WebSocket.OPEN) socket.send("1");
        ready.shift();
        if (ready.length) paint();
      });
    };
    const decode = async (data) => {
      const head = [...new Uint32Array(data, 0, 3)];
      const type = head[2] ? "image/png" : "image/jpeg";
      return { head, bitmap: await createImageBitmap(new Blob([new Uint8Array(data, 12)], { type })) };
    };
    socket.onmessage = (event) => {
      if (ready.push(decode(event.data)) === 1) paint();
    };
    socket.onclose = () => setTimeout(open, 1000);
  };
  onmessage = (event) => {
    ({ canvas, url } = event.data);
    paper = canvas.getContext("bitmaprenderer");
    open();
  };
};

export default {
  template: `<canvas role="img" aria-label="the picture" style="display:block;width:100%;height:auto"></canvas>`,
  emits: ["size"],
  props: { url: String, width: Number, height: Number },
  mounted() {
    this.$el.width = this.width;
    this.$el.height = this.height;
    window.gpusimPainted = window.gpusimPainted || [];
    this.worker = new Worker(URL.createObjectURL(new Blob([`(${work})()`], { type: "text/javascript" })));
    this.worker.onmessage = ({ data: [when, ...head] }) => {
      window.gpusimPainted.push([when - performance.timeOrigin, ...head]);
      if (window.gpusimPainted.length > 4096) window.gpusimPainted.splice(0, 2048);
    };
    const scheme = location.protocol === "https:" ? "wss://" : "ws://";
    const url = scheme + location.host + (window.path_prefix || "") + this.url;
    this.observer = new ResizeObserver(() =>
      this.$emit("size", { width: Math.round(this.$el.clientWidth * devicePixelRatio) }),
    );
    this.observer.observe(this.$el);
    const canvas = this.$el.transferControlToOffscreen();
    this.worker.postMessage({ canvas, url }, [canvas]);
  },
  unmounted() {
    this.worker.terminate();
    this.observer.disconnect();
  },
};
