"use strict";
// Draws the traces of the page: three pictures over the inserted length with one cursor, and a table that reads them.
(() => {
  if (typeof uPlot !== "function") return; // a browser too old for it: the page does without
  const data = JSON.parse(document.getElementById("data").textContent);
  const fields = [
    { label: "feed [m/s]", unit: 1e-4, digits: 3 },
    { label: "air [m³/h]", unit: 0.1, digits: 0 },
    { label: "radial rms [mm]", unit: 1e-4, digits: 4 },
  ];
  const MEAN = -1; // chosen instead of a tube
  const chooser = document.getElementById("tube");
  const place = document.getElementById("place");
  const hint = place.textContent;
  let plots = [];

  const element = (parent, name, text = "") => {
    const made = parent.appendChild(document.createElement(name));
    made.textContent = text;
    return made;
  };

  // what a policy did in a tube, or in the mean of those that have the metre
  const trace = (policy, tube, field) => {
    if (tube !== MEAN) {
      const column = policy.tubes[tube][field] || data.metres.map(() => null);
      return column.map((value) => (value === null ? null : value * fields[field].unit));
    }
    const columns = policy.tubes.filter((tube) => tube.length).map((tube) => tube[field]);
    return data.metres.map((_, metre) => {
      const values = columns.map((column) => column[metre]).filter((value) => value !== null);
      return values.length ? (fields[field].unit * values.reduce((sum, value) => sum + value, 0)) / values.length : null;
    });
  };

  const limits = () => data.metres.map(() => data.limit);
  const columns = (field) => {
    const drawn = data.policies.map((policy) => trace(policy, Number(chooser.value), field));
    return [data.metres, ...drawn, ...(field === 2 && data.limit ? [limits()] : [])];
  };

  // of vibration the root of the mean square
  const mean = (values, power) => {
    const present = values.filter((value) => value !== null);
    return present.length ? (present.reduce((sum, value) => sum + value ** power, 0) / present.length) ** (1 / power) : null;
  };

  const read = (metre) => {
    place.textContent = metre === null ? hint : `at ${data.metres[metre]} m`;
    data.policies.forEach((policy, row) => {
      fields.forEach(({ digits }, field) => {
        const values = plots[field].data[row + 1];
        const value = metre === null ? mean(values, field === 2 ? 2 : 1) : values[metre];
        policy.cells[field].textContent = value === null ? "" : value.toFixed(digits);
      });
    });
  };

  const options = (field) => {
    const limit = field === 2 && data.limit;
    const dashed = { label: "limit", stroke: "#55626f", dash: [4, 4], points: { show: false } };
    return {
      width: document.getElementById("plots").clientWidth,
      height: 210,
      legend: { show: false },
      cursor: { sync: { key: "metres" }, y: false },
      scales: { x: { time: false }, y: { range: (_, low, high) => [0, high > 0 ? 1.05 * high : 1] } },
      axes: [{ label: field === 2 ? "inserted length [m]" : undefined }, { label: fields[field].label, size: 64 }],
      series: [
        {},
        ...data.policies.map(({ name, colour, shown }) => ({ label: name, stroke: colour, width: 1.5, show: shown, points: { show: false } })),
        ...(limit ? [dashed] : []),
      ],
      hooks: { setCursor: [(plot) => plot === plots[field] && read(plot.cursor.idx ?? null)] },
    };
  };

  const choose = (tube) => {
    chooser.value = tube;
    plots.forEach((plot, field) => plot.setData(columns(field)));
    read(null);
  };

  // what was fed here, as a schedule that probe-env evaluate takes
  const save = (policy) => {
    const tube = Number(chooser.value);
    const [feed, air] = [trace(policy, tube, 0), trace(policy, tube, 1)];
    const rows = data.metres.flatMap((metre, k) => (feed[k] === null ? [] : [`${metre},${feed[k].toFixed(4)},${air[k].toFixed(1)}`]));
    const head = ["# interpolation: linear", "inserted_length_m,feed_speed_m_per_s,air_supply_m3_per_h"];
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([[...head, ...rows, ""].join("\n")], { type: "text/csv" }));
    link.download = `${policy.name.replace(/[^\w.-]+/g, "-")}-${tube === MEAN ? "mean" : `tube-${data.tubes[tube].number}`}.csv`;
    link.click();
    URL.revokeObjectURL(link.href);
  };

  const line = (policy, row) => {
    const cells = element(document.getElementById("readout"), "tr");
    const label = element(element(cells, "th"), "label");
    const box = element(label, "input");
    box.type = "checkbox";
    box.checked = policy.shown;
    box.addEventListener("change", () => plots.forEach((plot) => plot.setSeries(row + 1, { show: box.checked })));
    const swatch = element(label, "span");
    swatch.className = "swatch";
    swatch.style.background = policy.colour;
    label.append(policy.name);
    policy.cells = fields.map(() => element(cells, "td"));
    const worst = element(element(cells, "td"), "button", policy.worst);
    worst.addEventListener("click", () => choose(data.tubes.findIndex(({ number }) => number === policy.worst)));
    element(element(cells, "td"), "button", "CSV").addEventListener("click", () => save(policy));
  };

  document.getElementById("traces").hidden = false;
  element(chooser, "option", `mean over ${data.tubes.length}`).value = MEAN;
  data.tubes.forEach(({ number, text }, tube) => (element(chooser, "option", `${number}${text && `: ${text}`}`).value = tube));
  data.policies.forEach(line);
  chooser.addEventListener("change", () => choose(chooser.value));
  const parent = document.getElementById("plots");
  plots = fields.map((_, field) => new uPlot(options(field), columns(field), parent));
  read(null);
  addEventListener("resize", () => plots.forEach((plot) => plot.setSize({ width: parent.clientWidth, height: 210 })));
  document.querySelectorAll(".tubes tbody th").forEach((head, tube) => {
    head.setAttribute("role", "button");
    head.tabIndex = 0;
    const show = () => {
      choose(tube);
      document.getElementById("traces").scrollIntoView();
    };
    head.addEventListener("click", show);
    head.addEventListener("keydown", (event) => event.key === "Enter" && show());
  });
})();
