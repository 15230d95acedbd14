/* The page of `gffe view --export`. PAGE (data.js) lists frames, layers and figures. Pictures are PNG files, and values
   come with a script for each frame, because scripts may be loaded from a disk. */

const at = Object.fromEntries([...document.querySelectorAll('[id]')].map(element => [element.id, element]));
const MODES = { A: 'a', B: 'b', wipe: 'a', error: 'e' };  // with the side that is shown, of a wipe on the left
const [WIDTH, HEIGHT] = PAGE.size, SLOTS = PAGE.frames.map(frame => frame.slot);
const start = new URLSearchParams(location.hash.slice(1) || PAGE.start);
const state = {
  index: Math.max(SLOTS.indexOf(+start.get('frame')), 0), mode: start.get('mode') ?? 'A', pixel: start.get('pixel')?.split(',').map(Number),
  layer: start.get('layer') ?? Object.keys(PAGE.layers)[0], split: 0.5, zoom: 1, x: 0, y: 0, fitted: true,
};
const frame = () => PAGE.frames[state.index];
const channelsOf = side => frame().pictures[`${state.layer}.${side}`];
const file = ending => `frames/${String(frame().slot).padStart(5, '0')}.${ending}`;
const made = (kind, values) => Object.assign(document.createElement(kind), values);

// ---- values ---------------------------------------------------------------------------------------------------

let held = {};  // values of one frame: packed ones, and floats by the picture's name, all of them promises

function arrived(slot, values) {  // called by the script of a frame
  if (slot === held.slot) held.done(values);
}

function floats(name) {
  if (held.slot !== frame().slot) {
    held = { slot: frame().slot, floats: {} };
    held.packed = new Promise(done => { held.done = done; });
    document.head.append(made('script', { src: file('js') }));
  }
  return held.floats[name] ??= held.packed.then(values => unpacked(values[values[name][0] === '=' ? values[name].slice(1) : name], frame().pictures[name]));
}

async function unpacked(text, channels) {  // base64, zlib, all first bytes before all second ones, of differences of the floats' bits
  const bytes = Uint8Array.from(atob(text), letter => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream('deflate'));
  const planes = new Uint8Array(await new Response(stream).arrayBuffer()), count = planes.length / 4;
  const whole = new Uint8Array(planes.length);
  for (let i = 0; i < planes.length; i++) whole[4 * (i % count) + Math.floor(i / count)] = planes[i];
  const bits = new Uint32Array(whole.buffer);
  for (let i = channels; i < count; i++) bits[i] += bits[i - channels];
  return new Float32Array(whole.buffer);
}

const number = value => Number.isFinite(value) ? String(+value.toPrecision(4)) : String(value);

function words({ names, view, channels }, values) {
  if (names[values[0]]) return `${values[0]}: ${names[values[0]]}`;
  if (view === 'depth' && values[0] === Infinity) return 'sky';
  return [...values].map((value, i) => `${channels[i] ?? ''} ${number(value)}`.trim()).join('  ');
}

async function tell() {
  const { pixel, layer } = state, shown = frame();
  if (!pixel) return;
  history.replaceState(null, '', `#${new URLSearchParams({ frame: shown.slot, layer, mode: state.mode, pixel })}`);
  const lines = [`pixel ${pixel.join(', ')}`];
  for (const [side, label] of [['a', 'A'], ['b', 'B'], ['e', 'error']]) {
    const channels = channelsOf(side), first = (pixel[1] * WIDTH + pixel[0]) * channels;
    if (!channels) continue;
    const values = await floats(`${layer}.${side}`);
    if (shown !== frame() || pixel !== state.pixel || layer !== state.layer) return;
    lines.push(`${label}  ${words(PAGE.layers[layer][side], values.slice(first, first + channels))}`);
  }
  at.values.replaceChildren(...lines.map(textContent => made('div', { textContent })));
}

// ---- picture --------------------------------------------------------------------------------------------------

function place() {
  const { width, height } = at.stage.getBoundingClientRect(), line = state.split * width;
  if (state.fitted) {
    state.zoom = Math.min(width / WIDTH, height / HEIGHT);
    [state.x, state.y] = [(width - WIDTH * state.zoom) / 2, (height - HEIGHT * state.zoom) / 2];
  }
  const transform = `translate(${state.x}px, ${state.y}px) scale(${state.zoom})`;
  for (const image of [at.a, at.b]) Object.assign(image.style, { width: `${WIDTH}px`, height: `${HEIGHT}px`, transform });
  at.line.style.left = `${line}px`;
  at.b.style.clipPath = `inset(0 0 0 ${(line - state.x) / state.zoom}px)`;
}

function show() {
  const layer = PAGE.layers[state.layer], side = MODES[state.mode];
  at.a.hidden = !channelsOf(side);
  at.b.hidden = at.line.hidden = state.mode !== 'wipe' || !channelsOf('b');
  if (!at.a.hidden) at.a.src = file(`${state.layer}.${side}.png`);
  if (!at.b.hidden) at.b.src = file(`${state.layer}.b.png`);
  at.none.textContent = at.a.hidden ? `this frame has no such picture: ${state.mode}` : '';
  at.frame.textContent = frame().text;
  at.slot.value = state.index;
  for (const button of at.modes.children) {
    button.setAttribute('aria-pressed', button.value === state.mode);
    button.disabled = !layer[button.value === 'wipe' ? 'b' : MODES[button.value]];
  }
  legend(layer[side]);
  place();
  plot();
  tell();
}

function legend(layer) {
  const { kind, ticks = [], labels = [], unit, colors } = layer?.legend ?? {};
  const ramp = made('div', { className: 'ramp', style: `background: linear-gradient(to right, ${colors})` });
  const row = made('div', { className: 'ticks' });
  row.append(...ticks.map(([, text]) => made('span', { textContent: text })));
  at.legend.replaceChildren(made('div', { textContent: [layer?.label, unit].filter(Boolean).join(', ') }),
    ...(kind === 'none' || !kind ? [] : [ramp, row]),
    ...labels.map(([text, color]) => made('span', { textContent: text, style: `border-color: rgb(${color.map(share => 255 * share)})` })));
}

function plot() {
  const figure = PAGE.figures[at.quantity.value], { width, height } = at.plot.getBoundingClientRect();
  if (!figure) return;
  const all = [...Object.values(figure.a), ...Object.values(figure.b)], low = Math.min(...all), high = Math.max(...all);
  const x = slot => 8 + (width - 16) * (slot - SLOTS[0]) / Math.max(SLOTS.at(-1) - SLOTS[0], 1);
  const y = value => height - 10 - (height - 34) * (high > low ? (value - low) / (high - low) : 0.5);
  const text = value => value === undefined ? '–' : `${value.toFixed(figure.digits)} ${figure.unit}`;
  const sides = ['a', 'b'].filter(side => Object.keys(figure[side]).length);
  at.plot.innerHTML = `<line x1="${x(frame().slot)}" x2="${x(frame().slot)}" y2="${height}" stroke="#888"/>` + sides.map(side => {
    const points = Object.entries(figure[side]).map(([slot, value]) => [x(+slot), y(value)]);
    return `<g class="${side}"><polyline points="${points.join(' ')}"/>` + points.map(([cx, cy]) => `<circle cx="${cx}" cy="${cy}" r="2.5"/>`).join('') + '</g>';
  }).join('') + `<text x="8" y="14">${text(low)} to ${text(high)}, frames ${SLOTS[0]} to ${SLOTS.at(-1)}</text>`;
  at.figure.textContent = sides.map(side => `${side.toUpperCase()}: ${text(figure[side][frame().slot])}`).join('   ');
}

// ---- what a person does ---------------------------------------------------------------------------------------

const go = index => { state.index = Math.min(Math.max(index, 0), SLOTS.length - 1); show(); };
const fit = () => { state.fitted = true; place(); };
const inside = (event, element) => {
  const { left, top, width } = element.getBoundingClientRect();
  return { x: event.clientX - left, y: event.clientY - top, width };
};
let drags = '';

at.stage.onpointerdown = event => {
  const { x, width } = inside(event, at.stage);
  drags = !at.line.hidden && Math.abs(x - state.split * width) < 10 ? 'line' : 'picture';
  at.stage.setPointerCapture(event.pointerId);
  event.preventDefault();
};
at.stage.onpointermove = event => {
  const { x, y, width } = inside(event, at.stage);
  if (event.buttons && drags === 'line') state.split = Math.min(Math.max(x / width, 0), 1);
  else if (event.buttons) Object.assign(state, { x: state.x + event.movementX, y: state.y + event.movementY, fitted: false });
  if (event.buttons) place();
  const pixel = [x - state.x, y - state.y].map(value => Math.floor(value / state.zoom));
  if (Math.min(...pixel) >= 0 && pixel[0] < WIDTH && pixel[1] < HEIGHT) state.pixel = pixel;
  tell();
};
at.stage.addEventListener('wheel', event => {
  const { x, y } = inside(event, at.stage), factor = 2 ** (-Math.sign(event.deltaY) / 2);
  Object.assign(state, { x: x - (x - state.x) * factor, y: y - (y - state.y) * factor, zoom: state.zoom * factor, fitted: false });
  place();
  event.preventDefault();
}, { passive: false });
at.plot.onclick = event => {
  const { x, width } = inside(event, at.plot), wanted = SLOTS[0] + (x - 8) / (width - 16) * (SLOTS.at(-1) - SLOTS[0]);
  go(SLOTS.reduce((best, slot, i) => Math.abs(slot - wanted) < Math.abs(SLOTS[best] - wanted) ? i : best, 0));
};
document.onkeydown = event => {
  const keys = { ArrowRight: () => go(state.index + 1), ArrowLeft: () => go(state.index - 1), f: fit };
  [...at.modes.children].forEach((button, i) => { keys[i + 1] = () => button.click(); });
  if (!event.target.matches('select, input')) keys[event.key]?.();
};
at.slot.oninput = () => go(+at.slot.value);
at.layer.onchange = () => { state.layer = at.layer.value; show(); };
at.quantity.onchange = plot;
at.fit.onclick = fit;
onresize = show;

document.title = at.title.textContent = PAGE.title;
at.made.textContent = PAGE.made;
at.slot.max = SLOTS.length - 1;
at.layer.append(...Object.entries(PAGE.layers).map(([name, { a }]) => new Option(a?.label ?? name, name, false, name === state.layer)));
at.quantity.append(...Object.entries(PAGE.figures).map(([name, figure]) => new Option(figure.label, name)));
at.modes.append(...Object.keys(MODES).map(mode =>
  made('button', { textContent: mode, value: mode, onclick: () => { state.mode = mode; show(); } })));
show();
