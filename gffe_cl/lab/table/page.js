"use strict";
const results = JSON.parse(document.getElementById("results").textContent);
const pictures = JSON.parse(document.getElementById("pictures").textContent);
const report = document.getElementById("report");
// The figures that frames have.
const METRICS = ["psnr", "ssim", "flip", "flicker"];
const COSTS = ["milliseconds", "bytes_per_pixel", "against"];
const COLORS = ["#2f6fde", "#d9493f", "#2e9e5b", "#b06ad9", "#d98b1f", "#1f9fb0", "#c2508f", "#7d7f85"];
// Of REGIONS, in order: as the picture of regions shows them.
const REGION_COLORS = ["#e6463c", "#faa032", "#fadc46", "#5ac878", "#46a0fa", "#be6ef0", "#28282c"];
const titles = Object.fromEntries(results.methods.map(m => [m.name, m.title]));
const groups = Object.fromEntries(results.methods.map(m => [m.name, m.group]));
const columns = Object.fromEntries(results.columns.map(c => [c.name, c]));
const regions = Object.keys(results.regions);

/** An element: properties, then children (elements or text). */
function make(tag, properties = {}, ...children) {
  const element = Object.assign(document.createElement(tag), properties);
  for (const [name, value] of Object.entries(properties.attributes || {})) element.setAttribute(name, value);
  element.append(...children.filter(child => child !== null));
  return element;
}

function text(value, digits, signed = false) {
  if (value === null || value === undefined) return "–";
  const fixed = (Math.abs(value) < 0.5 * 10 ** -digits ? 0 : value).toFixed(digits).replace("-", "−");
  return signed && value > 0 && Number(value.toFixed(digits)) > 0 ? "+" + fixed : fixed;
}

const percent = (value, digits = 2) => value === null ? "–" : (100 * value).toFixed(digits) + "%";

/** A table that sorts. heads: [{title, higher}] (higher undefined: nothing is best); rows: [{cells: [{text, value}], …}];
    the first column holds names. */
function sortable(heads, rows, onRow = null) {
  const body = make("tbody");
  const elements = rows.map(row => {
    const cells = row.cells.map((cell, k) => {
      const element = make("td", {}, cell.node || cell.text);
      if (k && heads[k].higher !== undefined && cell.value !== null && cell.value !== undefined) {
        const known = rows.filter(r => !r.reference).map(r => r.cells[k].value).filter(v => v !== null && v !== undefined);
        const best = heads[k].higher ? Math.max(...known) : Math.min(...known);
        if (known.length > 1 && cell.value === best && !row.reference) element.className = "best";
      }
      return element;
    });
    const element = make("tr", {}, ...cells);
    element.dataset.name = row.name || "";
    if (onRow) element.addEventListener("click", () => onRow(row.name));
    return element;
  });
  body.append(...elements);
  const order = rows.map((_, k) => k);
  const head = make("tr", {}, ...heads.map((column, k) => {
    const cell = make("th", { title: column.hint || "" }, column.title);
    cell.addEventListener("click", () => {
      const descending = cell.getAttribute("aria-sort") ? cell.getAttribute("aria-sort") === "ascending" : column.higher !== false && k > 0;
      for (const other of head.children) other.removeAttribute("aria-sort");
      cell.setAttribute("aria-sort", descending ? "descending" : "ascending");
      const key = row => rows[row].cells[k].value ?? (k ? null : rows[row].cells[k].text);
      order.sort((a, b) => {
        const [x, y] = [key(a), key(b)];
        if (x === null || y === null || x === undefined || y === undefined) return (x === null || x === undefined) - (y === null || y === undefined);
        return (x < y ? -1 : x > y ? 1 : a - b) * (descending ? -1 : 1);
      });
      body.append(...order.map(row => elements[row]));
    });
    return cell;
  }));
  return make("div", { className: "scroll" }, make("table", {}, make("thead", {}, head), body));
}

const nameCell = (method, count = Infinity) => ({
  text: titles[method],
  node: make("span", { title: method }, titles[method], make("span", { className: "group" },
    count < results.sequences.length ? `${groups[method]}, on ${count} of ${results.sequences.length}` : groups[method])),
});
const waits = method => method === "interpolation" || /adds latency/.test(titles[method]);

function methodTable(rows, onRow) {
  const heads = [{ title: "method" }, ...results.columns.map(c => ({ title: c.title, higher: COSTS.includes(c.name) ? undefined : c.higher_is_better }))];
  return sortable(heads, rows.map(row => ({
    name: row.method, reference: waits(row.method) || row.sequences < results.sequences.length,
    cells: [nameCell(row.method, row.sequences), ...results.columns.map(c => ({ text: text(row[c.name], c.digits, c.name === "against"), value: row[c.name] }))],
  })), onRow);
}

function regionTable(rows) {
  const holder = make("div"), choice = make("select");
  for (const name of ["psnr", "ssim", "flip"]) if (columns[name]) choice.append(make("option", { value: name }, columns[name].title));
  const draw = () => {
    const column = columns[choice.value];
    const heads = [{ title: "method" }, ...regions.map(r => ({ title: r, hint: results.regions[r], higher: column.higher_is_better }))];
    holder.replaceChildren(sortable(heads, rows.map(row => ({
      name: row.method, reference: waits(row.method) || row.sequences < results.sequences.length,
      cells: [nameCell(row.method, row.sequences), ...regions.map(r => ({ text: text(row.regions[r][column.name], column.digits), value: row.regions[r][column.name] }))],
    }))));
  };
  choice.addEventListener("change", draw);
  draw();
  const legend = make("p", {}, ...regions.flatMap((r, k) => [make("i", { className: "swatch", style: `background:${REGION_COLORS[k]}` }), `${r}: ${results.regions[r]}. `]));
  return make("div", {}, make("div", { className: "controls" }, make("label", {}, "figure ", choice)), holder, legend);
}

/** Round numbers within a … b, about `count` of them: multiples of 1, 2 or 5 times a power of ten; and their digits after the point. */
function roundTicks(a, b, count) {
  const power = 10 ** Math.floor(Math.log10((b - a) / count)), step = power * [1, 2, 5, 10].find(s => s * power * count >= b - a);
  const ticks = [];
  for (let k = Math.ceil(a / step - 1e-9); k <= b / step + 1e-9; k++) ticks.push(k * step);
  return [ticks, Math.max(0, -Math.floor(Math.log10(step) + 1e-9))];
}

/** Lines over x: curves [{name, points: [[x, y]]}]. Title and label name units. */
function plot(title, label, curves) {
  const width = 520, height = 230, left = 52, right = 12, top = 22, bottom = 32, NS = "http://www.w3.org/2000/svg";
  const points = curves.flatMap(c => c.points);
  const range = k => { const v = points.map(p => p[k]), a = Math.min(...v), b = Math.max(...v), m = (b - a || 1) * 0.05; return [a - m, b + m]; };
  const [x0, x1] = range(0), [y0, y1] = range(1);
  const X = x => left + (x - x0) / (x1 - x0) * (width - left - right), Y = y => height - bottom - (y - y0) / (y1 - y0) * (height - top - bottom);
  const svg = document.createElementNS(NS, "svg");
  svg.setAttribute("viewBox", `0 0 ${width} ${height}`); svg.setAttribute("width", width);
  const add = (tag, attributes, content = "") => {
    const e = document.createElementNS(NS, tag);
    for (const [k, v] of Object.entries(attributes)) e.setAttribute(k, v);
    e.textContent = content; svg.append(e); return e;
  };
  const [xs, xDigits] = roundTicks(x0, x1, 6), [ys, yDigits] = roundTicks(y0, y1, 5);
  for (const y of ys) {
    add("line", { class: "axis", x1: left, x2: width - right, y1: Y(y), y2: Y(y) });
    add("text", { x: left - 6, y: Y(y) + 4, "text-anchor": "end" }, text(y, yDigits));
  }
  for (const x of xs) {
    add("line", { class: "axis", x1: X(x), x2: X(x), y1: height - bottom, y2: height - bottom + 4 });
    add("text", { x: X(x), y: height - 16, "text-anchor": "middle" }, text(x, xDigits));
  }
  add("text", { x: left, y: 13 }, title);
  add("text", { x: width - right, y: height - 3, "text-anchor": "end" }, label);
  for (const curve of curves) {
    add("polyline", { class: "curve", stroke: curve.color, points: curve.points.map(p => `${X(p[0])},${Y(p[1])}`).join(" ") });
    for (const p of curve.points) add("circle", { cx: X(p[0]), cy: Y(p[1]), r: 2.4, fill: curve.color });
  }
  return svg;
}

function plots(cells) {
  const holder = make("div"), choice = make("select");
  for (const name of METRICS) if (columns[name]) choice.append(make("option", { value: name }, columns[name].title));
  const wanted = new Set(cells.map(c => c.method).filter(m => ["gffe", "interpolation", "guided", "motion-vectors", "static-reprojection", "repeat"].includes(m) || /ONNX/.test(titles[m])));
  if (!wanted.size) cells.slice(0, 6).forEach(c => wanted.add(c.method));
  const more = make("select", {}, make("option", { value: "" }, "add or remove a method …"), ...cells.map(c => make("option", { value: c.method }, titles[c.method])));
  const draw = () => {
    const name = choice.value, column = columns[name], shown = cells.filter(c => wanted.has(c.method));
    const colored = shown.map((c, k) => ({ name: c.method, color: COLORS[k % COLORS.length], frames: c.frames.filter(f => f[name] !== null && f[name] !== undefined) }));
    const alphas = [...new Set(colored.flatMap(c => c.frames.map(f => Math.round(f.alpha * 1e4) / 1e4)))].sort((a, b) => a - b);
    const drawn = [plot(`${column.title} over time`, "time, s", colored.map(c => ({ ...c, points: c.frames.map(f => [f.time, f[name]]) })))];
    if (alphas.length > 1 && alphas.length <= 16) {
      const mean = (c, a) => { const v = c.frames.filter(f => Math.abs(f.alpha - a) < 1e-3).map(f => f[name]); return v.reduce((s, x) => s + x, 0) / v.length; };
      drawn.push(plot(`${column.title} over α, mean`, "α, intervals", colored.map(c => ({ ...c, points: alphas.map(a => [a, mean(c, a)]) }))));
    }
    const legend = make("div", { className: "legend" }, ...colored.map(c => make("span", {}, make("i", { style: `background:${c.color}` }), titles[c.name])));
    holder.replaceChildren(make("div", { className: "plots" }, ...drawn), legend);
  };
  more.addEventListener("change", () => { const m = more.value; if (m) wanted.has(m) ? wanted.delete(m) : wanted.add(m); more.value = ""; draw(); });
  choice.addEventListener("change", draw);
  draw();
  return make("div", {}, make("div", { className: "controls" }, make("label", {}, "figure ", choice), more), holder);
}

/** Two pictures of a sequence: flipped while the pointer is on them, wiped, or their errors. */
function stage(sequence, cells) {
  const of = pictures[sequence], methods = cells.map(c => c.method).filter(m => of[m]);
  const lists = [make("select"), make("select")];
  for (const list of lists) {
    list.append(make("option", { value: "|truth" }, "ground truth"), make("option", { value: "|rendered" }, "rendered frame before"), make("option", { value: "|regions" }, "regions"));
    for (const m of methods) list.append(make("option", { value: `${m}|shown` }, titles[m]));
  }
  lists[0].value = methods.includes("gffe") ? "gffe|shown" : `${methods[0] || ""}|${methods.length ? "shown" : "rendered"}`;
  lists[1].value = "|truth";
  const below = make("img", { alt: "" }), above = make("img", { alt: "", className: "over" }), line = make("div", { className: "line" });
  const names = [make("div", { className: "name left" }), make("div", { className: "name right" })];
  const box = make("div", { className: "stage" }, below, above, line, ...names);
  let mode = "flip", at = 0.5, inside = false;
  const source = value => { const [m, kind] = value.split("|"); return of[m][mode === "error" && kind === "shown" ? "error" : kind]; };
  const caption = list => list.selectedOptions[0].textContent + (mode === "error" && list.value.endsWith("|shown") ? ", error × 4" : "");
  const draw = () => {
    above.src = source(lists[0].value); below.src = source(lists[1].value);
    const wipe = mode !== "flip";
    above.style.clipPath = wipe ? `inset(0 ${100 * (1 - at)}% 0 0)` : "";
    above.style.visibility = !wipe && inside ? "hidden" : "visible";
    line.style.display = wipe ? "" : "none"; line.style.left = `${100 * at}%`;
    names[0].textContent = wipe || !inside ? caption(lists[0]) : caption(lists[1]);
    names[1].textContent = wipe ? caption(lists[1]) : "";
    names[1].style.display = wipe ? "" : "none";
  };
  box.addEventListener("pointerenter", () => { inside = true; draw(); });
  box.addEventListener("pointerleave", () => { inside = false; draw(); });
  box.addEventListener("pointermove", event => { const r = box.getBoundingClientRect(); at = Math.min(Math.max((event.clientX - r.left) / r.width, 0), 1); if (mode !== "flip") draw(); });
  const modes = [["flip", "flip on hover"], ["wipe", "wipe"], ["error", "error maps"]].map(([name, title]) => {
    const button = make("button", { type: "button" }, title);
    button.addEventListener("click", () => { mode = name; modes.forEach(b => b.setAttribute("aria-pressed", b === button)); draw(); });
    button.setAttribute("aria-pressed", name === mode);
    return button;
  });
  lists.forEach(list => list.addEventListener("change", draw));
  draw();
  const choose = method => { if (of[method]) { lists[0].value = `${method}|shown`; draw(); box.scrollIntoView({ block: "nearest" }); } };
  return [make("div", {}, make("div", { className: "controls" }, lists[0], "and", lists[1], ...modes), box), choose];
}

function budgetTable(rows) {
  const heads = [{ title: "region" }, { title: "of the pixels" }, { title: "of the squared error" }, { title: "dB gained if it were perfect" }];
  return sortable(heads, rows.map(r => ({ cells: [
    { text: r.region }, { text: percent(r.pixels), value: r.pixels }, { text: percent(r.error, 1), value: r.error }, { text: text(r.gain, 2, true), value: r.gain },
  ] })));
}

function overview() {
  const versions = Object.entries(results.versions).map(([name, v]) => `${name} ${v}`).join(", ");
  report.append(
    make("h1", {}, "Frame extrapolation, evaluated"),
    make("p", {}, `${results.date}. ${results.command}. ${results.machine}. ${versions}.`),
    make("nav", {}, ...results.sequences.map(s => make("a", { href: `#${encodeURIComponent(s.name)}` }, s.name))),
    make("h2", {}, "All methods"),
    make("p", {}, "Means over the sequences; the best of each column is marked, apart from what waits for the next frame or was not measured on all of them. A click on a head sorts."),
    methodTable(results.means),
    make("h2", {}, "By region"),
    make("p", {}, "All frames of all sequences together."),
    regionTable(results.means));
  if (results.gains.length) {
    const heads = [{ title: "part" }, { title: "whole frame, dB" }, { title: "in its region, dB" }, { title: "region" }, { title: "the paper, dB" }];
    report.append(make("h2", {}, "What each part is worth"),
      make("p", {}, "Gains in PSNR of having it: means over frames and sequences; in the region for whose sake it is there, all frames together; the paper's own (whole frame, its eight scenes)."),
      sortable(heads, results.gains.map(g => ({ cells: [
        { text: g.title }, { text: text(g.mean, 2, true), value: g.mean }, { text: text(g.in_region, 2, true), value: g.in_region },
        { text: g.region, value: g.region }, { text: text(g.paper, 2, true), value: g.paper },
      ] }))));
  }
  if (results.budget.all) report.append(make("h2", {}, "Where the error is"), make("p", {}, "Of GFFE, all sequences together."), budgetTable(results.budget.all));
  if (results.late.length) late();
  if (results.skipped.length) report.append(make("h2", {}, "Left out"),
    ...results.skipped.map(s => make("p", {}, `${titles[s.what] || s.what}${s.sequences.length ? ` (${s.sequences.join(", ")})` : ""}: ${s.reason}`)));
}

function late() {
  const heads = [{ title: "method" }, { title: "turn, °" }, ...["psnr", "ssim", "flip"].map(n => ({ title: columns[n].title })), { title: "not shown before" }];
  const names = [...new Set(results.late.map(r => r.method))];
  const title = Object.fromEntries(results.late.map(r => [r.method, r.title]));
  const curves = names.map((name, k) => ({ name, color: COLORS[k], points: results.late.filter(r => r.method === name).map(r => [r.turn, r.psnr]) }));
  report.append(make("h2", {}, "Late warp"),
    make("p", {}, "A rendered frame shown at its own time, from a camera that has turned to the right since."),
    plot("PSNR, dB, over the turn", "turn, degrees", curves),
    make("div", { className: "legend" }, ...curves.map(c => make("span", {}, make("i", { style: `background:${c.color}` }), title[c.name]))),
    sortable(heads, results.late.map(r => ({ cells: [
      { text: r.title }, { text: String(r.turn), value: r.turn },
      ...["psnr", "ssim", "flip"].map(n => ({ text: text(r[n], columns[n].digits), value: r[n] })), { text: percent(r.disoccluded), value: r.disoccluded },
    ] }))));
}

function section(sequence) {
  const cells = results.cells.filter(c => c.sequence === sequence.name);
  const [pair, choose] = stage(sequence.name, cells);
  const how = sequence.exact ? "Regions are exact." : "Regions are as GFFE found them.";
  const element = make("section", { id: sequence.name },
    make("h2", {}, sequence.name),
    make("p", {}, `${sequence.size.join(" × ")} pixels, ${sequence.moments} frames measured. ${how} Shown: t = ${sequence.picture.time.toFixed(3)} s, α = ${sequence.picture.alpha.toFixed(2)}.`),
    pair, make("h3", {}, "Over time"), plots(cells),
    make("h3", {}, "Methods"), make("p", {}, "A click on a row shows its picture."), methodTable(cells, choose),
    make("h3", {}, "By region"), regionTable(cells));
  if (results.budget[sequence.name]) element.append(make("h3", {}, "Where GFFE's error is"), budgetTable(results.budget[sequence.name]));
  report.append(element);
}

report.replaceChildren();
overview();
results.sequences.forEach(section);
if (location.hash) document.getElementById(decodeURIComponent(location.hash.slice(1)))?.scrollIntoView();
