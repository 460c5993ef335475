// Numbers from the page: base64 of little-endian single precision, NaN where there is none.
function unpack(packed) {
  const bytes = Uint8Array.from(atob(packed.bdata), (c) => c.charCodeAt(0));
  return new Float32Array(bytes.buffer);
}

// The last index whose instant is not after t; -1 before the first.
function indexAt(times, t) {
  let low = -1, high = times.length;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (times[middle] <= t) low = middle; else high = middle;
  }
  return low;
}

// The value at t, straight between samples or held; NaN outside and in gaps.
function valueAt(times, values, t, held) {
  const k = indexAt(times, t);
  const last = times.length - 1;
  if (k < 0 || t > times[last] + 1e-6) return NaN;
  if (held || k === last) return values[k];
  const step = times[k + 1] - times[k];
  return step > 0 ? values[k] + (values[k + 1] - values[k]) * (t - times[k]) / step : values[k];
}

const SVG = 'http://www.w3.org/2000/svg';

function draw(parent, tag, attributes, text) {
  const element = document.createElementNS(SVG, tag);
  place(element, attributes);
  if (text !== undefined) element.textContent = text;
  parent.appendChild(element);
  return element;
}

function place(element, attributes) {
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
}

function pointList(points) {
  return points.map(([x, y]) => `${x.toFixed(1)},${y.toFixed(1)}`).join(' ');
}

// The way through points, with gaps where there is none.
function way(points) {
  let pen = 'M';
  return points.map((point) => {
    const step = point ? `${pen}${point[0].toFixed(1)} ${point[1].toFixed(1)}` : '';
    pen = point ? 'L' : 'M';
    return step;
  }).join('');
}

function show(element, visible) {
  element.style.display = visible ? '' : 'none';
}
