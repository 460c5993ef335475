// Plants as their shapes: in the plane from above, in space from the side and from above.
const SVG = 'http://www.w3.org/2000/svg';

function plantScene(scene, holder) {
  const times = unpack(scene.times);
  const vehicles = scene.vehicles.map((vehicle) => ({ ...vehicle,
    goal: readShapes(vehicle.goal), planned: readShapes(vehicle.planned), measured: readShapes(vehicle.measured) }));
  const ground = readShapes(scene.ground);
  const moving = vehicles.flatMap(({ planned, measured }) => [...planned, ...measured]);
  const [x, y] = [0, 1].map((axis) => extent(moving, (p) => p[axis]));
  const along = scene.space && y[1] - y[0] > x[1] - x[0] ? 1 : 0;  // the wider of x and y, to the right
  const views = (scene.space
    ? [['side', [along, 2], 1], ['top', [along, 1 - along], along ? -1 : 1]]
    : [['plane', [0, 1], 1]]
  ).map(([name, axes, up]) => sceneView(name, axes, up, { vehicles, ground, times, holder, wide: !scene.space }));
  return {
    update: (t) => views.forEach((view) => view.update(t)),
    resize: () => views.forEach((view) => view.resize()),
  };
}

function readShapes(shapes) {
  return (shapes || []).map((shape) => {
    const points = unpack(shape.points);
    const frame = shape.corners * shape.size;
    // the points at a frame, straight between frames for a share in between
    const at = (k, share = 0) => Array.from({ length: shape.corners }, (_, corner) =>
      Array.from({ length: shape.size }, (_, axis) => {
        const index = k * frame + corner * shape.size + axis;
        return share ? points[index] + share * (points[index + frame] - points[index]) : points[index];
      }));
    return { ...shape, at, frames: points.length / frame };
  });
}

function extent(shapes, coordinate) {
  let low = Infinity, high = -Infinity;
  for (const shape of shapes) {
    for (let k = 0; k < shape.frames; k++) {
      for (const point of shape.at(k)) {
        const value = coordinate(point);
        if (!Number.isFinite(value)) continue;
        low = Math.min(low, value - shape.radius);
        high = Math.max(high, value + shape.radius);
      }
    }
  }
  return low < high ? [low, high] : [(low || 0) - 0.5, (low || 0) + 0.5].map((v) => (Number.isFinite(v) ? v : 0));
}

function sceneView(name, axes, up, { vehicles, ground, times, holder, wide }) {
  const figure = document.createElement('figure');
  const svg = draw(figure, 'svg', { id: `scene-${name}`, role: 'img', 'aria-label': `${name} view` });
  if (!wide) figure.appendChild(Object.assign(document.createElement('figcaption'), { textContent: `${name} view` }));
  holder.appendChild(figure);
  const all = [...ground, ...vehicles.flatMap(({ planned, measured }) => [...planned, ...measured])];
  const project = (point) => [point[axes[0]], up * point[axes[1]]];
  const [[left, right], [bottom, top]] = [0, 1].map((k) => extent(all, (p) => project(p)[k]));
  let scale = 1, origin = [0, 0], bodies = [];
  const at = (point) => {
    const [across, high] = project(point);
    return [origin[0] + scale * (across - left), origin[1] - scale * (high - bottom)];
  };
  const several = vehicles.length > 1;

  function resize() {
    const margin = { left: 40, right: 12, top: 12, bottom: 32 };
    const width = Math.max(160, Math.floor(figure.clientWidth));
    const room = wide ? Math.max(320, Math.min(620, window.innerHeight - 240)) : Math.min(width, 400);
    scale = Math.min((width - margin.left - margin.right) / (right - left),
      (room - margin.top - margin.bottom) / (top - bottom));
    const slack = width - margin.left - margin.right - scale * (right - left);
    const height = Math.ceil(scale * (top - bottom)) + margin.top + margin.bottom;
    origin = [margin.left + Math.max(0, slack / 2), height - margin.bottom];
    svg.replaceChildren();
    place(svg, { viewBox: `0 0 ${width} ${height}`, width, height, 'data-scale': scale });
    drawAxes();
    ground.forEach((shape) => put(element(svg, shape, 'ground'), shape, shape.at(0)));
    bodies = [];
    vehicles.forEach(drawVehicle);
  }

  function drawAxes() {
    const step = tickStep(Math.max(right - left, top - bottom), Math.min(6, Math.max(2, scale * (right - left) / 60)));
    const [x0, y0] = origin, x1 = x0 + scale * (right - left), y1 = y0 - scale * (top - bottom);
    for (const value of ticks(left, right, step)) {
      const x = x0 + scale * (value - left);
      draw(svg, 'line', { class: 'grid', x1: x, x2: x, y1: y0, y2: y1 });
      draw(svg, 'text', { class: 'tick', x, y: y0 + 15, 'text-anchor': 'middle' }, tidy(value));
    }
    for (const value of ticks(bottom, top, step)) {
      const y = y0 - scale * (value - bottom);
      draw(svg, 'line', { class: 'grid', x1: x0, x2: x1, y1: y, y2: y });
      draw(svg, 'text', { class: 'tick', x: x0 - 6, y: y + 4, 'text-anchor': 'end' }, tidy(up * value));
    }
    draw(svg, 'text', { class: 'tick', x: (x0 + x1) / 2, y: y0 + 29, 'text-anchor': 'middle' },
      `${'xyz'[axes[0]]}, ${'xyz'[axes[1]]} [m]`);
  }

  function drawVehicle(vehicle, index) {
    const colour = (kind) => (several ? `--c${vehicle.colour}` : `--${kind}`);
    const group = (kind, role, number = {}) => draw(svg, 'g', { class: `vehicle ${role}`, ...number,
      style: `stroke: var(${colour(kind)}); fill: var(${colour(kind)})` });
    const goal = group('planned', 'goal');
    vehicle.goal.forEach((shape) => put(element(goal, shape, ''), shape, shape.at(0)));
    const alone = !vehicle.measured.length;
    for (const kind of ['planned', 'measured']) {
      if (!vehicle[kind].length) continue;
      const parent = group(kind, kind === 'planned' && alone ? 'planned alone' : kind, { 'data-vehicle': index });
      const body = { shapes: vehicle[kind], parent, parts: [], trails: [], name: null };
      for (const shape of vehicle[kind].filter((s) => s.trail)) {
        const points = Array.from({ length: shape.frames }, (_, k) => traced(shape, shape.at(k)))
          .map((p) => (p.every(Number.isFinite) ? at(p) : null));
        const path = draw(parent, 'path', { class: kind === 'planned' ? 'path' : 'trail' });
        if (kind === 'planned') place(path, { d: way(points) });
        else body.trails.push({ path, points });
      }
      body.parts = vehicle[kind].map((shape) => element(parent, shape, ''));
      if (several && (kind === 'measured' || alone)) {
        body.name = draw(parent, 'text', { class: 'name', 'text-anchor': 'middle' }, vehicle.name);
      }
      bodies.push(body);
    }
  }

  function update(t) {
    const k = Math.min(Math.max(indexAt(times, t), 0), times.length - 2);
    const share = Math.min(Math.max((t - times[k]) / ((times[k + 1] - times[k]) || 1), 0), 1);
    for (const { shapes, parent, parts, trails, name } of bodies) {
      const placed = shapes.map((shape) => shape.at(k, share));
      show(parent, placed[0].flat().every(Number.isFinite));
      shapes.forEach((shape, i) => put(parts[i], shape, placed[i]));
      for (const { path, points } of trails) place(path, { d: way(points.slice(0, k + 1)) });
      if (name) {
        const [x, y] = at(placed[0][0]);
        place(name, { x, y: y - scale * Math.max(...shapes.map((s) => s.radius)) - 5 });
      }
    }
  }

  function element(parent, shape, role) {
    const tag = shape.kind === 'disc' ? 'circle' : shape.kind === 'box' && shape.size === 2 ? 'polygon' : 'polyline';
    return draw(parent, tag, { class: `${role} ${shape.kind} ${shape.style}`.trim() });
  }

  function put(part, shape, points) {
    const known = points.flat().every(Number.isFinite);
    show(part, known);
    if (!known) return;
    const placed = points.map(at);
    if (shape.kind === 'disc') place(part, { cx: placed[0][0], cy: placed[0][1], r: scale * shape.radius });
    else place(part, { points: pointList(placed) });
  }

  return { update, resize };
}

// The point whose way is drawn: the last of a line, the centre of a disc or of a box.
function traced(shape, points) {
  if (shape.kind !== 'box') return points[points.length - 1];
  const opposite = points[shape.size === 2 ? 2 : 9];
  return points[0].map((value, axis) => (value + opposite[axis]) / 2);
}

function tickStep(span, count) {
  const rough = span / count;
  const power = 10 ** Math.floor(Math.log10(rough));
  return [1, 2, 5, 10].map((m) => m * power).find((step) => step >= rough);
}

function ticks(low, high, step) {
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9; k++) found.push(k * step);
  return found;
}

function tidy(value) {
  return String(Number(value.toFixed(6)) || 0);
}

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
