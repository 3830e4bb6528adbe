// The live picture: frames from a websocket, painted on a canvas, one per screen refresh, each acknowledged when it is
// painted. A frame is 12 bytes, its number, the version of the settings and a kind, little-endian, and a JPEG or PNG.
export default {
  template: `<canvas style="display:block;width:100%;height:auto"></canvas>`,
  props: { url: String, width: Number, height: Number },
  mounted() {
    this.$el.width = this.width;
    this.$el.height = this.height;
    this.paper = this.$el.getContext("bitmaprenderer");
    this.alive = true;
    window.gpusimPainted = window.gpusimPainted || [];
    this.open();
  },
  unmounted() {
    this.alive = false;
    this.socket.close();
  },
  methods: {
    open() {
      const scheme = location.protocol === "https:" ? "wss://" : "ws://";
      const socket = (this.socket = new WebSocket(scheme + location.host + (window.path_prefix || "") + this.url));
      socket.binaryType = "arraybuffer";
      const ready = []; // promises, so that frames stay in order however long each takes to decode
      const paint = async () => {
        const { bitmap, head } = await ready[0];
        requestAnimationFrame(() => {
          if (bitmap.width !== this.$el.width || bitmap.height !== this.$el.height) {
            this.$el.width = bitmap.width;
            this.$el.height = bitmap.height;
          }
          this.paper.transferFromImageBitmap(bitmap);
          window.gpusimPainted.push([performance.now(), ...head]);
          if (window.gpusimPainted.length > 4096) window.gpusimPainted.splice(0, 2048);
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
      socket.onclose = () => this.alive && setTimeout(() => this.open(), 1000);
    },
  },
};
