// The content of a panel. It is replaced outside of Vue, which would draw all elements of the page again each time.
export default {
  template: `<div style="width:100%"></div>`,
  emits: ["ready"],
  mounted() {
    this.$emit("ready");
  },
  methods: {
    show(html) {
      this.$el.innerHTML = html;
    },
  },
};
