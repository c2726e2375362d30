// SPDX-License-Identifier: Apache-2.0
// The slider of the page "What accuracy costs": reads the table that stands there.
(function () {
  const by = (id) => document.getElementById("prices-" + id);
  const policies = [...document.querySelectorAll("#prices tbody tr")].map((row) => {
    const cells = [...row.cells].map((cell) => cell.textContent);
    return { row, name: cells[0], preset: row.dataset.preset === "1",
             error: [Number(cells[1]), Number(cells[2])], time: [Number(cells[3]), Number(cells[4])] };
  });
  const left = 50, right = 590, top = 10, bottom = 290, slowest = 20;
  const x = (error) => left + (right - left) * (Math.log10(Math.max(error, 1e-14)) + 14) / 14;
  const y = (time) => bottom - (bottom - top) * Math.log(Math.min(time, slowest) / 0.3) / Math.log(slowest / 0.3);
  const element = (name, attributes, text) => {
    const made = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const key in attributes) made.setAttribute(key, attributes[key]);
    if (text) made.textContent = text;
    return made;
  };
  function draw() {
    const of = Number(by("of").value), bound = 10 ** Number(by("bound").value);
    const within = policies.filter((p) => p.error[of] <= bound);
    const best = within.reduce((a, b) => (!a || b.time[of] < a.time[of] ? b : a), null);
    by("is").textContent = bound.toPrecision(2) + (bound < 1 / 255 ? "" : " (" + (255 * bound).toFixed(1) + " steps of 8 bits)");
    by("says").textContent = best
      ? best.name + ": an error of " + best.error[of] + " at most, in " + best.time[of] + " times the time of Exact32."
      : "No policy is as exact as that.";
    const chart = by("chart");
    chart.replaceChildren(
      element("rect", { x: left, y: top, width: Math.max(0, x(bound) - left), height: bottom - top, fill: "#eef2f5" }),
      element("text", { x: (left + right) / 2, y: 325, "text-anchor": "middle" }, "largest error"),
      element("text", { x: -(top + bottom) / 2, y: 14, transform: "rotate(-90)", "text-anchor": "middle" }, "time"));
    for (const time of [0.3, 1, 3, 10])
      chart.append(element("line", { x1: left, x2: right, y1: y(time), y2: y(time), stroke: "#d8dee4" }),
                   element("text", { x: left - 6, y: y(time) + 4, "text-anchor": "end" }, String(time)));
    for (let power = -14; power <= 0; power += 2)
      chart.append(element("text", { x: x(10 ** power), y: 308, "text-anchor": "middle" }, "1e" + power));
    for (const p of policies) {
      const chosen = p === best, point = element("circle", {
        cx: x(p.error[of]), cy: y(p.time[of]), r: chosen ? 7 : 4,
        fill: chosen ? "#b3261e" : p.preset ? "#0b5cad" : "#9aa5b1" });
      point.append(element("title", {}, p.name));
      chart.append(point);
      const aside = p.error[of] > 1e-3 && p.error[of] < 0.01 ? -1 : 1; // that names stand apart
      if (chosen || p.preset)
        chart.append(element("text", { x: x(p.error[of]) + 8 * aside, y: y(p.time[of]) - 8, "font-weight": chosen ? 700 : 400,
                                       "text-anchor": aside < 0 ? "end" : "start" }, p.name));
      p.row.style.background = chosen ? "#fde8e6" : p.error[of] <= bound ? "" : "#f5f7f9";
      p.row.style.color = p.error[of] <= bound ? "" : "#8a949e";
    }
  }
  by("bound").addEventListener("input", draw);
  by("of").addEventListener("change", draw);
  draw();
})();
