// columns sort by the files' own numbers, or by what is read; a second click turns the order round; what is no number stays behind
for (const head of document.querySelectorAll("thead th")) {
  const button = document.createElement("button");
  button.append(...head.childNodes);
  head.append(button);
  const body = head.closest("table").tBodies[0], column = head.cellIndex;
  const key = (row) => {
    const cell = row.cells[column], number = Number(cell.querySelector("data")?.getAttribute("value") ?? (cell.textContent.trim() || NaN));
    return Number.isNaN(number) ? cell.textContent.trim() : number;
  };
  button.addEventListener("click", () => {
    const down = head.getAttribute("aria-sort") === "ascending";
    for (const other of head.parentNode.cells) other.removeAttribute("aria-sort");
    head.setAttribute("aria-sort", down ? "descending" : "ascending");
    const order = (a, b) => (down ? -1 : 1) * (typeof a === "number" ? a - b : a.localeCompare(b));
    const rows = [...body.rows].map((row) => [key(row), row]).sort(([a], [b]) => (typeof a > typeof b) - (typeof a < typeof b) || order(a, b));
    body.append(...rows.map(([, row]) => row));
  });
}

for (const film of document.querySelectorAll(".film")) {
  const data = JSON.parse(film.querySelector("script").textContent);
  const section = film.closest("section.scene");
  const controls = film.querySelector(".controls");
  const slider = controls.querySelector("input"), button = controls.querySelector("button");
  const clock = controls.querySelector("output");
  const choice = controls.querySelector("select.factor"), zoom = controls.querySelector("select.zoom");
  const stage = film.querySelector(".stage"), pictures = [...stage.querySelectorAll("svg")];
  const shapes = data.bodies.map((body) => new Shape(body, data.time.length));
  const turning = data.turns && new Turning(data.turns.middle);
  for (const shape of shapes) shape.turning = turning;
  const lines = shapes.filter((shape) => !shape.triangles);
  const groups = [...film.querySelectorAll(".body")];
  const palette = data.stops && paletteOf(data.stops);
  const canvas = film.querySelector("canvas");
  const surfaces = canvas && new Surfaces(canvas, shapes, data.width, data.height, palette);
  film.classList.add("live");
  const now = film.querySelector(".legend .now"), printed = [...film.querySelectorAll(".instant span")];
  if (now) now.hidden = false;
  const charts = [...section.querySelectorAll("figure[data-axis]")].map((figure) => {
    const [left, right, top, bottom, start, end] = figure.dataset.axis.split(" ").map(Number);
    const svg = figure.querySelector("svg"), line = document.createElementNS(svg.namespaceURI, "line");
    line.setAttribute("class", "instant");
    line.setAttribute("y1", top);
    line.setAttribute("y2", bottom);
    svg.append(line);
    const { output: name, factor, unit } = figure.dataset;
    return { left, right, start, end, line, value: figure.querySelector("figcaption output"), name, factor: Number(factor), unit };
  });
  const largest = Object.fromEntries(Object.entries(data.outputs).map(([name, values]) => [name, Math.max(...values.map((v) => Math.abs(v ?? 0)))]));
  // four digits; what is nothing but round-off is zero
  const shown = (value, most) => {
    const text = Math.abs(value) < 1e-9 * most ? "0" : value.toPrecision(4);
    return text.includes("e+") ? `${Number(text)}` : text; // 24250, not 2.425e+4
  };
  const stroke = (shape, frame, a, b) =>
    css(palette[Math.max(...[a, b].map((node) => { const shade = shape.shade(frame, node); return shade > 254 ? 0 : shade; }))]);
  const drawLine = (shape, group, frame, factor) => {
    const p = shape.at(frame, factor), c = shape.lines;
    const piece = (k) => `M${Math.round(p[3 * c[k]])} ${Math.round(p[3 * c[k] + 1])}L${Math.round(p[3 * c[k + 1]])} ${Math.round(p[3 * c[k + 1] + 1])}`;
    const pieces = Array.from({ length: c.length / 2 }, (_, k) => piece(2 * k));
    const paths = [...group.querySelectorAll("path")];
    paths.forEach((path, k) => {
      const one = shape.shades && k > 0;
      path.setAttribute("d", one ? pieces[k - 1] : pieces.join(""));
      if (one) path.setAttribute("stroke", stroke(shape, frame, c[2 * k - 2], c[2 * k - 1]));
    });
    const nodes = c.length ? shape.ends : Array.from({ length: shape.n }, (_, k) => k);
    group.querySelectorAll("circle").forEach((circle, k) => {
      circle.setAttribute("cx", Math.round(p[3 * nodes[k]]));
      circle.setAttribute("cy", Math.round(p[3 * nodes[k] + 1]));
    });
  };
  // the node that a closer look goes along with: of the largest stress, or nearest to a place
  const nearest = (x, y, frame, factor) => {
    let found = null, least = Infinity;
    for (const shape of shapes) {
      const p = shape.at(frame, factor);
      for (let k = 0; k < shape.n; k++) {
        const far = Math.hypot(p[3 * k] - x, p[3 * k + 1] - y);
        if (far < least) [found, least] = [{ shape, node: k }, far];
      }
    }
    return found;
  };
  const hottest = () => {
    let found = null, most = -1;
    for (const shape of shapes)
      for (let k = 0; shape.shades && k < shape.n; k++) {
        const shade = shape.shade(data.start, k);
        if (shade < 255 && shade > most) [found, most] = [{ shape, node: k }, shade];
      }
    return found ?? nearest(data.width / 2, data.height / 2, data.start, 1);
  };
  let target = hottest();
  const lengthText = (length) => {
    const own = data.metre !== "m" || length >= 0.1; // metres alone have prefixes
    const [factor, unit] = own ? [1, data.metre] : length >= 1e-4 ? [1e3, "mm"] : [1e6, "µm"];
    return `${Number((length * factor).toPrecision(3))} ${unit}`;
  };
  const traces = [...film.querySelectorAll(".paths path")], grounds = [...film.querySelectorAll(".ground path")].map((path) => [path, path.getAttribute("d").split("l")[0]]);
  const turn = () => {
    const at = (place) => turning.of([...place]).slice(0, 2).map(Math.round).join(" ");
    traces.forEach((path, k) => path.setAttribute("d", `M${data.turns.paths[k].map(at).join("L")}`));
    grounds.forEach((entry, k) => (entry[1] = `M${at(data.turns.ground[k])}`));
    draw();
  };
  const look = (frame, factor) => {
    const closer = Number(zoom.value), width = data.width / closer, height = data.height / closer;
    const p = closer > 1 ? target.shape.at(frame, factor).subarray(3 * target.node) : null;
    const [x, y] = p ? [p[0] - width / 2, p[1] - height / 2] : [0, 0];
    for (const picture of pictures) picture.setAttribute("viewBox", `${x} ${y} ${width} ${height}`);
    const bar = film.querySelector(".scale");
    bar.setAttribute("transform", `translate(${x} ${y}) scale(${1 / closer})`);
    bar.querySelector("text").textContent = lengthText(data.bar / closer);
    for (const circle of film.querySelectorAll("circle")) circle.style.r = `${(circle.getAttribute("r") * 1) / closer}px`;
    for (const [path, from] of grounds) path.setAttribute("d", `${from}l${-150 / closer} ${250 / closer}h${300 / closer}z`);
    return { x, y, width };
  };
  const draw = () => {
    const frame = Number(slider.value), factor = choice ? Number(choice.value) : 1, time = data.time[frame];
    const seen = look(frame, factor);
    lines.forEach((shape, number) => drawLine(shape, groups[number], frame, factor));
    if (surfaces) surfaces.draw(frame, factor, seen);
    clock.textContent = `${time.toFixed(data.decimals)} s`;
    printed[0].textContent = clock.textContent;
    printed[1].textContent = factor;
    if (now) now.querySelector("output").textContent = `${shown(data.stress[frame], Math.max(...data.stress))} ${data.unit}`;
    for (const chart of charts) {
      const x = chart.left + ((time - chart.start) / (chart.end - chart.start)) * (chart.right - chart.left);
      chart.line.setAttribute("x1", x);
      chart.line.setAttribute("x2", x);
      const values = data.outputs[chart.name];
      if (!chart.value || !values) continue;
      const value = values[frame];
      chart.value.textContent = value === null ? "" : `${shown(chart.factor * value, chart.factor * largest[chart.name])} ${chart.unit} at ${clock.textContent}`.replace("  ", " ");
    }
  };
  let running = null, last = 0;
  const stop = () => { cancelAnimationFrame(running); running = null; button.textContent = "▶"; };
  const step = (now) => {
    if (now - last > 40) {
      last = now;
      slider.value = (Number(slider.value) + 1) % data.time.length;
      draw();
    }
    running = requestAnimationFrame(step);
  };
  button.addEventListener("click", () => {
    if (running !== null) return stop();
    button.textContent = "❚❚";
    running = requestAnimationFrame(step);
  });
  slider.addEventListener("input", () => { if (running !== null) stop(); draw(); });
  if (choice) choice.addEventListener("change", draw);
  zoom.addEventListener("change", draw);
  // a film in space turns with the pointer and with the arrows of the keyboard
  let dragged = false, from = null;
  if (turning) {
    stage.classList.add("turns");
    stage.tabIndex = 0;
    const by = (across, down) => { turning.by(across, down); turn(); };
    stage.addEventListener("pointerdown", (event) => { [dragged, from] = [false, event]; });
    addEventListener("pointerup", () => { from = null; });
    addEventListener("pointermove", (event) => {
      if (!from) return;
      const x = event.clientX - from.clientX, y = event.clientY - from.clientY;
      if (!dragged && Math.hypot(x, y) < 5) return;
      [dragged, from] = [true, event];
      by((4 * x) / stage.clientWidth, (4 * y) / stage.clientWidth);
    });
    const arrows = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] };
    stage.addEventListener("keydown", (event) => {
      if (event.key === "Home") { turning.back(); turn(); }
      if (arrows[event.key]) { event.preventDefault(); by(...arrows[event.key]); }
    });
  }
  stage.addEventListener("click", (event) => {
    if (dragged) return void (dragged = false);
    const frame = Number(slider.value), factor = choice ? Number(choice.value) : 1;
    const box = stage.getBoundingClientRect(), seen = look(frame, factor), unit = seen.width / box.width;
    target = nearest(seen.x + (event.clientX - box.left) * unit, seen.y + (event.clientY - box.top) * unit, frame, factor);
    if (zoom.value === "1") zoom.value = "5";
    draw();
  });
  addEventListener("resize", draw);
  // paper has one picture, all of that of the largest stress
  let before = null;
  const show = (frame, closer) => { [slider.value, zoom.value] = [frame, closer]; draw(); };
  addEventListener("beforeprint", () => { stop(); before = [slider.value, zoom.value]; show(data.start, "1"); });
  addEventListener("afterprint", () => { if (before) show(...before); });
  controls.hidden = false;
  draw();
}
