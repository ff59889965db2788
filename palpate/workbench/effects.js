// The list of effects; it is redrawn row by row, and the rest of the page is left alone.
export default {
  template: `
    <div class="list">
      <div v-for="row in rows" v-show="row.seen" :key="row.name" class="effect" :data-effect="row.name"
           :class="{ chosen: row.chosen, alike: row.alike, last: row.together }" :style="{ order: row.order }">
        <q-checkbox dense :label="row.label" :title="row.physics" :model-value="row.chosen"
                    @update:model-value="tick(row)" />
        <div class="evidence" :title="row.about"><span :class="row.look">
          <i v-if="row.share !== null" :style="{ width: row.share + 'px' }"></i>{{ row.mark }}</span></div>
        <div class="picture" role="button" tabindex="0" :title="hint" :aria-label="'picture of ' + row.name"
             v-html="row.picture || 'about'" @click="$emit('picture', row.name)"
             @keydown.enter="$emit('picture', row.name)"></div>
        <div class="signature" :title="row.equation">{{ row.signature }}</div>
        <div v-if="row.together" class="together" :title="alike">{{ row.together }}</div>
      </div>
    </div>`,
  props: { effects: Array, hint: String, alike: String },
  emits: ["ready", "tick", "picture"],
  data() {
    return { rows: JSON.parse(JSON.stringify(this.effects)) };
  },
  mounted() {
    this.$emit("ready");
  },
  methods: {
    tick(row) {
      row.chosen = !row.chosen;
      this.$emit("tick", row.name);
    },
    change(changes) {
      for (const row of this.rows) Object.assign(row, changes[row.name]);
    },
  },
};
