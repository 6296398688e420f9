// What a page does after it has been drawn: span figures, links, sorting, series, keys.
window.certnav = (() => {
  const read = (id) => {
    const tag = document.getElementById(id);
    return tag ? JSON.parse(tag.textContent) : null;
  };
  const numbers = (text, Kind) =>
    new Kind(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
  const documents = () => (typeof Bokeh === "undefined" ? [] : Bokeh.documents);
  const models = () => documents().flatMap((doc) => [...doc._all_models.values()]);
  const model = (name) => {
    for (const doc of documents()) {
      const found = doc.get_model_by_name(name);
      if (found) return found;
    }
    return null;
  };
  const format = (x, unit) => {
    if (!Number.isFinite(x)) return "—";
    const text = Math.abs(x) < 1000 ? Number(x.toPrecision(3)).toString() : x.toFixed(0);
    return unit === "°" || unit === "" ? text + unit : `${text} ${unit}`;
  };

  // Statistics: each is a function of the rows in the span, as numpy would have it.
  const known = (xs) => Array.from(xs).filter(Number.isFinite);
  const rms = (xs) => Math.sqrt(xs.reduce((sum, x) => sum + x * x, 0) / xs.length);
  const mean = (xs) => xs.reduce((sum, x) => sum + x, 0) / xs.length;
  const percentile = (xs, p) => {
    const sorted = Float64Array.from(xs).sort(), at = (sorted.length - 1) * p;
    const low = Math.floor(at), high = Math.min(low + 1, sorted.length - 1);
    return sorted[low] + (at - low) * (sorted[high] - sorted[low]);
  };
  const largest = (xs) => xs.reduce((most, x) => Math.max(most, Math.abs(x)), 0);
  const statistics = { rms, mean, largest, p50: (xs) => percentile(xs, 0.5),
    p95: (xs) => percentile(xs, 0.95), share: (xs) => 100 * mean(xs) };

  let table = null, from = null, to = null, range = null, whole = null, span = null;

  function load() {
    const raw = read("span-data");
    if (!raw) return;
    table = { t: numbers(raw.t, Float64Array), rows: raw.rows, columns: {} };
    const columns = table.columns;
    for (const [name, text] of Object.entries(raw.columns))
      columns[name] = numbers(text, name === "inside" ? Uint8Array : Float32Array);
    if (!columns.horizontal) {
      const { north, east, up } = columns;
      columns.horizontal = Float64Array.from(north, (x, k) => Math.hypot(x, east[k]));
      columns.position = Float64Array.from(north, (x, k) => Math.hypot(x, east[k], up[k]));
    }
  }
  function figures(low, high) {
    const inside = [];
    table.t.forEach((t, k) => { if (t >= low && t <= high) inside.push(k); });
    const out = {};
    for (const row of table.rows) {
      const column = table.columns[row.column];
      const xs = known(inside.map((k) => column[k]));
      out[row.name] = xs.length ? statistics[row.statistic](xs) : NaN;
    }
    return [inside.length, out];
  }
  function show(low, high) {
    for (const [field, value] of [[from, low], [to, high]])  // never under a typing hand
      if (field !== document.activeElement) field.value = value.toFixed(2);
    if (!table) return;
    const [count, values] = figures(low, high);
    for (const row of table.rows) {
      const cell = document.querySelector(`[data-span="${row.name}"]`);
      if (!cell) continue;
      cell.textContent = format(values[row.name], row.unit);
      cell.dataset.value = values[row.name];
    }
    const cell = document.querySelector('[data-span="count"]');
    if (cell) cell.textContent = count;
  }
  function shade(low, high) {
    model("span")?.setv({ left: low, right: high });
  }
  // Lines are thinned to what a page of the whole shows; of a short span all epochs are here.
  const thinned = new Map();
  function refine() {
    if (!table) return;
    const t = table.t;
    let first = t.findIndex((x) => x >= range.start), last = t.findLastIndex((x) => x <= range.end);
    first = Math.max(first - 1, 0);
    last = Math.min(last + 2, t.length);
    const near = last - first <= 5000 && last - first < t.length;
    for (const source of models().filter((m) => m.tags?.some?.((tag) => tag.startsWith("full:")))) {
      if (!thinned.has(source)) thinned.set(source, source.data);
      if (!near) { source.data = thinned.get(source); continue; }
      const name = source.tags.find((tag) => tag.startsWith("full:")).slice(5);
      const steps = Array.from(t.subarray(first + 1, last), (x, k) => x - t[first + k]).sort((a, b) => a - b);
      const hole = Math.max(1.5, 5 * (steps[steps.length >> 1] ?? 0)), at = [], y = [];
      for (let k = first; k < last; k++) {
        if (k > first && t[k] - t[k - 1] > hole) { at.push(NaN); y.push(NaN); }
        at.push(t[k]);
        y.push(table.columns[name][k]);
      }
      source.data = { t: at, y };
    }
  }
  // The ordinate follows the lines that ask for it; a band may widen it by a little only.
  function rescale() {
    for (const plot of plots()) {
      let low = Infinity, high = -Infinity, edge = 0;
      for (const drawn of plot.renderers) {
        const data = drawn.data_source?.data;
        if (!data?.t) continue;
        const lines = drawn.data_source.tags.includes("scale");
        for (let k = 0; k < data.t.length; k++) {
          if (data.t[k] < range.start || data.t[k] > range.end) continue;
          if (lines && Number.isFinite(data.y[k])) {
            low = Math.min(low, data.y[k]);
            high = Math.max(high, data.y[k]);
          }
          if (data.high) edge = Math.max(edge, data.high[k], -data.low[k]);
        }
      }
      if (!(high >= low)) continue;
      if (plot.tags.includes("error")) {
        const most = Math.max(high, -low), limit = 1.15 * Math.max(most, Math.min(edge, 1.6 * most));
        [low, high] = limit > 0 ? [-limit, limit] : [-1, 1];
      } else {
        const room = 0.08 * (high - low) || 0.5;
        [low, high] = [low - room, high + room];
      }
      plot.y_range.setv({ start: low, end: high });
    }
  }
  const is_plot = (m) => m.type === "Plot" || m.type === "Figure";
  const plots = () => models().filter((m) => is_plot(m) && m.x_range === range
    && m.renderers.some((r) => r.data_source?.tags?.includes("scale")));

  let waiting = null;
  function zoomed() {
    clearTimeout(waiting);
    waiting = setTimeout(() => {
      refine();
      rescale();
      if (!span) show(Math.max(range.start, whole[0]), Math.min(range.end, whole[1]));
    }, 80);
  }
  function zoom(low, high) {
    if (high - low < 0.02) return;
    range.setv({ start: Math.max(low, whole[0]), end: Math.min(high, whole[1]) });
  }
  function select(low, high) {
    span = Math.abs(high - low) > 1e-6 ? [Math.min(low, high), Math.max(low, high)] : null;
    shade(...(span ?? [NaN, NaN]));
    show(...(span ?? [range.start, range.end]));
  }
  function clear() {
    span = null;
    shade(NaN, NaN);
    range.setv({ start: whole[0], end: whole[1] });
    zoomed();
  }
  // Where the vehicle was when the pointer is over a plot.
  function point(t) {
    const here = model("here"), source = model("track");
    if (!here || !source || !Number.isFinite(t)) return;
    const times = source.data.t;
    let low = 0, high = times.length - 1;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (times[middle] < t) low = middle + 1; else high = middle;
    }
    here.data = { x: [source.data.x[low]], y: [source.data.y[low]] };
  }
  function colour(name) {
    const source = model("track"), mapper = model("track-colours"), bar = model("track-bar");
    const kinds = read("track-kinds");
    if (!source || !kinds?.[name]) return;
    mapper.setv({ palette: kinds[name].palette, low: kinds[name].low, high: kinds[name].high });
    source.data = { ...source.data, c: source.data[name] };
    if (bar) bar.title = kinds[name].title;
  }
  function sort(heading) {
    const body = heading.closest("table").tBodies[0], column = heading.cellIndex;
    const up = heading.getAttribute("aria-sort") !== "ascending";
    const value = (row) => {
      const cell = row.cells[column], text = cell?.textContent.trim() ?? "";
      const number = parseFloat(cell?.dataset.value ?? text.replace("−", "-").replaceAll(",", ""));
      return Number.isNaN(number) ? text : number;
    };
    [...body.rows].sort((a, b) => {
      const [x, y] = [value(a), value(b)];
      const order = typeof x === typeof y ? (x < y ? -1 : x > y ? 1 : 0) : typeof x === "number" ? -1 : 1;
      return up ? order : -order;
    }).forEach((row) => body.append(row));
    for (const other of heading.parentNode.cells) other.removeAttribute("aria-sort");
    heading.setAttribute("aria-sort", up ? "ascending" : "descending");
  }
  // Everything drawn of a series, in all plots.
  function show_series(button, on) {
    button.setAttribute("aria-pressed", on);
    const tag = `series:${button.dataset.series}`;
    for (const m of models()) if (m.tags?.includes(tag)) m.visible = on;
  }
  // What the keys do to the plots below an element: zoom about the middle, move, or the whole.
  const keys = { "+": [0.5, 0], "=": [0.5, 0], "-": [2, 0], ArrowLeft: [1, -0.25], ArrowRight: [1, 0.25] };
  function press(event, place) {
    const id = place.querySelector("[data-root-id]")?.dataset.rootId;
    const root = documents().map((doc) => doc.get_model_by_id(id)).find(Boolean);
    if (!root || (event.key !== "0" && !keys[event.key])) return;
    event.preventDefault();
    const shown = [...root.references()].filter(is_plot);
    if (range && shown.some((plot) => plot.x_range === range)) {
      if (event.key === "0") clear(); else by(...keys[event.key])();
    } else if (event.key === "0") {
      for (const plot of shown) plot.reset.emit();
    } else {
      for (const axis of new Set(shown.map((plot) => plot.x_range)))
        move(axis, shown.find((plot) => plot.x_range === axis).x_scale.type === "LogScale", ...keys[event.key]);
    }
  }
  function move(axis, logarithmic, factor, shift) {
    if (axis.type === "FactorRange") return;
    const [there, back] = logarithmic ? [Math.log, Math.exp] : [(x) => x, (x) => x];
    const [low, high] = [there(axis.start), there(axis.end)], width = high - low;
    const middle = (low + high) / 2 + shift * width;
    axis.setv({ start: back(middle - (factor * width) / 2), end: back(middle + (factor * width) / 2) });
  }
  const by = (factor, shift) => () => {
    const middle = (range.start + range.end) / 2 + shift * (range.end - range.start);
    const half = factor * (range.end - range.start) / 2;
    const low = Math.min(Math.max(middle - half, whole[0]), Math.max(whole[1] - 2 * half, whole[0]));
    zoom(low, low + 2 * half);
  };
  // Names of what was drawn that do not fit beside each other go below each other.
  function wrap_legends() {
    for (const legend of models()) {
      if (legend.type !== "Legend" || legend.orientation !== "horizontal") continue;
      const wide = legend.items.map((item) => 44 + 7 * String(item.label.value ?? item.label).length);
      const room = Math.min(window.innerWidth, 1168) - 90, all = wide.reduce((sum, w) => sum + w, 0);
      if (all > room)
        legend.ncols = Math.max(1, Math.min(wide.length - 1, Math.floor(room / Math.max(...wide))));
    }
  }
  function start() {
    wrap_legends();
    for (const heading of document.querySelectorAll("table.sortable thead th")) {
      heading.tabIndex = 0;
      heading.addEventListener("click", () => sort(heading));
      heading.addEventListener("keydown", (e) => {
        if (e.key !== "Enter" && e.key !== " ") return;
        e.preventDefault();
        sort(heading);
      });
    }
    for (const group of document.querySelectorAll(".switches")) {
      const series = [...group.querySelectorAll("[data-series]")];
      for (const button of series)
        button.addEventListener("click", () =>
          show_series(button, button.getAttribute("aria-pressed") !== "true"));
      for (const every of group.querySelectorAll("[data-all]"))
        every.addEventListener("click", () =>
          series.forEach((button) => show_series(button, every.dataset.all === "true")));
    }
    for (const place of document.querySelectorAll(".plot"))
      place.addEventListener("keydown", (e) => press(e, place));
    document.getElementById("track-colour")?.addEventListener("change", (e) => colour(e.target.value));
    document.getElementById("track-tiles")?.addEventListener("click", (e) => {
      const tiles = model("tiles");
      tiles.visible = !tiles.visible;
      e.target.setAttribute("aria-pressed", tiles.visible);
    });
    // A finger scrolls the page; a mouse zooms.
    if (matchMedia("(pointer: coarse)").matches)
      for (const m of models()) if (m.type === "Toolbar") m.active_drag = null;
    range = model("time");
    if (range) start_time();
    document.body.dataset.ready = "yes";
  }
  function start_time() {
    [from, to] = [document.getElementById("span-from"), document.getElementById("span-to")];
    whole = [range.start, range.end];
    load();
    if (!from) return;
    for (const field of [from, to])
      field.addEventListener("change", () => {
        const [low, high] = [+from.value, +to.value];
        span = null;
        shade(NaN, NaN);
        zoom(low, high);
      });
    const actions = { "span-in": by(0.5, 0), "span-out": by(2, 0), "span-back": by(1, -0.5),
      "span-on": by(1, 0.5), "span-whole": clear };
    for (const [id, action] of Object.entries(actions))
      document.getElementById(id)?.addEventListener("click", action);
    for (const link of document.querySelectorAll("[data-from]"))
      link.addEventListener("click", () => {
        const [low, high] = [+link.dataset.from, +link.dataset.to];
        const room = Math.max(5, 0.2 * (high - low));
        zoom(low - room, high + room);
        select(low, high);
      });
    range.properties.start.change.connect(zoomed);
    range.properties.end.change.connect(zoomed);
    rescale();
    show(...whole);
  }
  const ready = () => {
    const drawn = !document.querySelector(".plot") || documents().length;
    if (drawn && !document.querySelector(".plot:empty")) start(); else setTimeout(ready, 30);
  };
  document.addEventListener("DOMContentLoaded", () => setTimeout(ready, 0));
  return { select, zoom, clear, point, colour, figures };
})();
