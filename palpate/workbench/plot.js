// A plotly figure that changes trace by trace, and is drawn only while somebody sees it.
export default {
  template: '<div class="plot" :style="{ minHeight: height + \'px\' }"></div>', // what is below stays
  props: { figure: Object },
  emits: ["ready", "zoom", "point"],
  data() {
    return { height: this.figure.layout?.height };
  },
  async mounted() {
    this.now = JSON.parse(JSON.stringify(this.figure)); // Vue's watched copies are slow to read
    this.stale = true;
    const { Plotly } = await import("nicegui-plotly");
    this.Plotly = Plotly;
    this.watch = new IntersectionObserver((seen) => {
      this.visible = seen[seen.length - 1].isIntersecting;
      this.paint();
    }, { rootMargin: "50px" });
    this.watch.observe(this.$el);
    this.resizing = new ResizeObserver(() => this.resize());
    this.resizing.observe(this.$el);
    this.$emit("ready");
  },
  unmounted() {
    this.watch?.disconnect();
    this.resizing?.disconnect();
    if (this.begun) this.Plotly.purge(this.$el);
  },
  methods: {
    replace(figure) {
      this.now = figure;
      this.stale = true;
      this.paint();
    },
    restyle(values, traces) {
      if (this.visible && !this.stale) return void this.Plotly.restyle(this.$el, values, traces);
      for (const [name, each] of Object.entries(values))
        traces.forEach((trace, place) => (this.now.data[trace][name] = each[place]));
      this.stale = true;
      this.paint();
    },
    resize() {
      if (!this.begun || this.width === this.$el.clientWidth) return;
      this.stale = true; // a hidden figure is drawn at the new width once it is seen
      this.paint();
    },
    layout() {
      this.width = this.$el.clientWidth;
      const layout = { ...this.now.layout, width: this.width };
      if (this.now.narrow && this.width < 460)
        for (const [name, value] of Object.entries(this.now.narrow))
          layout[name] = typeof value === "object" ? { ...layout[name], ...value } : value;
      this.height = layout.height;
      return layout;
    },
    relayout(layout) {
      if (this.visible && !this.stale) return void this.Plotly.relayout(this.$el, layout);
      Object.assign(this.now.layout, layout);
      this.stale = true;
      this.paint();
    },
    paint() {
      if (!this.Plotly || !this.visible || !this.stale || !this.now.data) return;
      this.stale = false;
      this.Plotly.react(this.$el, this.now.data, this.layout(), { displaylogo: false, ...this.now.config });
      if (!this.begun) this.listen();
      this.begun = true;
    },
    listen() {
      this.$el.on("plotly_click", (event) => event.points?.length && this.$emit("point", event.points[0].x));
      this.$el.on("plotly_relayout", (change) => {
        const low = change["xaxis.range[0]"];
        const range = low === undefined ? change["xaxis.range"] : [low, change["xaxis.range[1]"]];
        if (range) this.$emit("zoom", range);
        else if (change["xaxis.autorange"]) this.$emit("zoom", null);
      });
    },
  },
};
