"use strict";
for (const film of document.querySelectorAll(".film")) {
  const data = JSON.parse(film.querySelector("script").textContent);
  const section = film.closest("section.scene");
  const controls = film.querySelector(".controls");
  const slider = controls.querySelector("input"), button = controls.querySelector("button");
  const clock = controls.querySelector("output"), choice = controls.querySelector("select");
  const groups = [...film.querySelectorAll(".body")];
  const charts = [...section.querySelectorAll("figure[data-axis]")].map((figure) => {
    const [left, right, top, bottom, start, end] = figure.dataset.axis.split(" ").map(Number);
    const svg = figure.querySelector("svg"), line = document.createElementNS(svg.namespaceURI, "line");
    line.setAttribute("class", "instant");
    line.setAttribute("y1", top);
    line.setAttribute("y2", bottom);
    svg.append(line);
    return { left, right, start, end, line, value: figure.querySelector("figcaption output"), name: figure.dataset.output };
  });
  // rigid shape plus enlarged deformation, as the paths of film.py are written
  const points = (body, frame, factor) => {
    const at = body.at[frame];
    if (!body.extra || factor === 1) return at;
    const more = body.extra[frame], gain = (factor - 1) * body.step;
    return at.map((value, k) => Math.round(value + gain * more[k]));
  };
  const draw = () => {
    const frame = Number(slider.value), factor = Number(choice.value), time = data.time[frame];
    data.bodies.forEach((body, number) => {
      const p = points(body, frame, factor), c = body.cells;
      let d = "";
      for (let k = 0; k < c.length; k += 2) d += `M${p[2 * c[k]]} ${p[2 * c[k] + 1]}L${p[2 * c[k + 1]]} ${p[2 * c[k + 1] + 1]}`;
      for (const path of groups[number].querySelectorAll("path")) path.setAttribute("d", d);
      const nodes = c.length ? body.ends : p.slice(0, p.length / 2).map((_, k) => k);
      groups[number].querySelectorAll("circle").forEach((circle, k) => {
        circle.setAttribute("cx", p[2 * nodes[k]]);
        circle.setAttribute("cy", p[2 * nodes[k] + 1]);
      });
    });
    clock.textContent = `${time.toFixed(3)} s`;
    for (const chart of charts) {
      const x = chart.left + ((time - chart.start) / (chart.end - chart.start)) * (chart.right - chart.left);
      chart.line.setAttribute("x1", x);
      chart.line.setAttribute("x2", x);
      const values = data.outputs[chart.name];
      if (chart.value && values && values[frame] !== null) chart.value.textContent = `${values[frame].toPrecision(4)} at ${time.toFixed(3)} s`;
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
  choice.addEventListener("change", draw);
  controls.hidden = false;
  draw();
}
