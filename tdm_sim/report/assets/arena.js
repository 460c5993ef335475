// The arena from above: x to the right, y up, in metres.
function arenaScene(scene, holder) {
  const times = unpack(scene.times);
  const robots = scene.robots.map((robot) => ({
    ...robot, planned: unpackColumns(robot.planned), measured: unpackColumns(robot.measured),
  }));
  const box = arenaBox(scene, robots);
  const figure = document.createElement('figure');
  const svg = draw(figure, 'svg', { id: 'arena', role: 'img', 'aria-label': 'arena from above' });
  holder.appendChild(figure);
  let scale = 1, left = 0, bottom = 0, bodies = [];
  const at = (x, y) => [left + scale * (x - box.left), bottom - scale * (y - box.bottom)];

  function resize() {
    const margin = { left: 34, right: 10, top: 10, bottom: 30 };
    const width = Math.max(200, Math.floor(figure.clientWidth));
    const room = Math.min(width, Math.max(320, Math.min(640, window.innerHeight - 240)));
    scale = Math.min((width - margin.left - margin.right) / (box.right - box.left),
      (room - margin.top - margin.bottom) / (box.top - box.bottom));
    const drawn = scale * (box.right - box.left);
    const height = Math.ceil(scale * (box.top - box.bottom)) + margin.top + margin.bottom;
    left = margin.left + Math.max(0, (width - margin.left - margin.right - drawn) / 2);
    bottom = height - margin.bottom;
    svg.replaceChildren();
    place(svg, { viewBox: `0 0 ${width} ${height}`, width, height, 'data-scale': scale });
    drawGround();
    robots.forEach(drawPaths);
    bodies = robots.map((robot, k) => ({
      planned: robot.planned ? drawRobot(robot, k, 'planned', !robot.measured) : null,
      measured: robot.measured ? drawRobot(robot, k, 'measured', true) : null,
    }));
  }

  function drawGround() {
    const [x0, y0] = at(box.left, box.bottom), [x1, y1] = at(box.right, box.top);
    const step = tickStep(box.right - box.left, 5);
    for (const value of ticks(box.left, box.right, step)) {
      const [x] = at(value, 0);
      draw(svg, 'line', { class: 'grid', x1: x, x2: x, y1: y0, y2: y1 });
      draw(svg, 'text', { class: 'tick', x, y: y0 + 16, 'text-anchor': 'middle' }, tidy(value));
    }
    for (const value of ticks(box.bottom, box.top, step)) {
      const [, y] = at(0, value);
      draw(svg, 'line', { class: 'grid', x1: x0, x2: x1, y1: y, y2: y });
      draw(svg, 'text', { class: 'tick', x: x0 - 6, y: y + 4, 'text-anchor': 'end' }, tidy(value));
    }
    draw(svg, 'text', { class: 'tick', x: (x0 + x1) / 2, y: y0 + 28, 'text-anchor': 'middle' },
      'x, y [m]');
    if (scene.length !== null && scene.width !== null) {
      const [wx, wy] = at(0, scene.width);
      draw(svg, 'rect', { class: 'wall', x: wx, y: wy, width: scale * scene.length,
        height: scale * scene.width });
      if (scene.separation !== null) drawClearance(scene.separation / 2);
    }
    for (const [x, y, radius] of scene.obstacles) {
      const [cx, cy] = at(x, y);
      draw(svg, 'circle', { class: 'obstacle', cx, cy, r: scale * radius });
    }
  }

  // Centres of robots stay half a separation away from the walls.
  function drawClearance(inset) {
    const [x, y] = at(inset, scene.width - inset);
    draw(svg, 'rect', { class: 'clearance', x, y, width: scale * (scene.length - 2 * inset),
      height: scale * (scene.width - 2 * inset) });
  }

  function drawPaths(robot) {
    if (robot.planned) {
      const path = pathOf(robot.planned).filter(Boolean);
      draw(svg, 'polyline', { class: 'path', points: pointList(path), style: `stroke: var(--c${robot.colour})` });
    }
    if (robot.goal) {
      const [x, y, yaw] = robot.goal;
      const [cx, cy] = at(x, y);
      const r = Math.max(5, scale * (scene.separation || 0.3) * 0.3);
      const goal = draw(svg, 'g', { class: 'goal', style: `stroke: var(--c${robot.colour})` });
      draw(goal, 'circle', { cx, cy, r });
      draw(goal, 'line', { x1: cx, y1: cy, x2: cx + r * Math.cos(yaw), y2: cy - r * Math.sin(yaw) });
    }
  }

  function pathOf(columns, until = Infinity) {
    const path = [];
    for (let k = 0; k < columns.x.length && k <= until; k++) {
      path.push(Number.isFinite(columns.x[k]) ? at(columns.x[k], columns.y[k]) : null);
    }
    return path;
  }

  function drawRobot(robot, index, kind, named) {
    const alone = kind === 'planned' && named ? ' alone' : '';
    const group = draw(svg, 'g', { class: `robot ${kind}${alone}`, 'data-robot': index,
      style: `stroke: var(--c${robot.colour}); fill: var(--c${robot.colour})` });
    const trail = kind === 'measured' ? draw(group, 'path', { class: 'trail' }) : null;
    const body = draw(group, 'g', { class: 'body' });
    const half = scale * (scene.separation || 0.3) / 2;
    const r = half * 0.62;
    if (scene.separation !== null) draw(body, 'circle', { class: 'separation', r: half });
    const plume = draw(body, 'polygon', { class: 'plume' });
    draw(body, 'circle', { class: 'hull', r });
    draw(body, 'line', { class: 'heading', x1: 0, y1: 0, x2: r, y2: 0 });
    const label = named
      ? draw(group, 'text', { class: 'name', 'text-anchor': 'middle' }, robot.name) : null;
    const wide = label ? label.getComputedTextLength() : 0;
    return { group, trail, body, plume, label, wide, r, half };
  }

  function update(t) {
    const index = indexAt(times, t);
    robots.forEach((robot, k) => {
      for (const kind of ['planned', 'measured']) {
        if (robot[kind] && bodies[k]) move(bodies[k][kind], robot[kind], t, index);
      }
    });
    placeNames();
  }

  function move(body, columns, t, index) {
    const [x, y, yaw, alpha, thrust] = ['x', 'y', 'yaw', 'alpha', 'thrust']
      .map((name) => valueAt(times, columns[name], t));
    const known = Number.isFinite(x) && Number.isFinite(y);
    show(body.group, known);
    if (!known) return;
    const [cx, cy] = at(x, y);
    const turn = Number.isFinite(yaw) ? yaw : 0;
    body.body.setAttribute('transform',
      `translate(${cx.toFixed(2)} ${cy.toFixed(2)}) rotate(${(-turn * 180 / Math.PI).toFixed(2)})`);
    body.plume.setAttribute('points', plume(body, alpha, thrust));
    if (body.trail) body.trail.setAttribute('d', way([...pathOf(columns, index), [cx, cy]]));
    body.centre = [cx, cy];
  }

  // Names stand above their robots, or wherever they cover the least of the others.
  function placeNames() {
    const shown = bodies.flatMap(({ planned, measured }) => [planned, measured])
      .filter((body) => body && body.label && body.group.style.display !== 'none');
    const { width, height } = svg.viewBox.baseVal;
    const taken = [];
    for (const body of shown) {
      const [cx, cy] = body.centre;
      const half = body.wide / 2 + 2;
      const spots = [[cx, cy - body.half - 5], [cx, cy + body.half + 14],
        [cx + body.half + half + 2, cy + 4], [cx - body.half - half - 2, cy + 4]];
      const others = shown.filter((other) => other !== body)
        .map(({ centre: [x, y], r }) => [x - r, y - r, x + r, y + r]);
      const cost = ([x, y]) => {
        const box = [x - half, y - 12, x + half, y + 3];
        const outside = box[0] < 0 || box[1] < 0 || box[2] > width || box[3] > height;
        return (outside ? 1e6 : 0) + [...others, ...taken]
          .reduce((sum, other) => sum + overlap(box, other), 0);
      };
      const costs = spots.map(cost);
      const [x, y] = spots[costs.indexOf(Math.min(...costs))];
      taken.push([x - half, y - 12, x + half, y + 3]);
      place(body.label, { x: Math.min(Math.max(x, half), width - half), y });
    }
  }

  // The jet leaves against the force, which acts along yaw + alpha; as long as the limit is wide.
  function plume(body, alpha, thrust) {
    const share = thrust / (scene.thrustLimit || 1);
    if (!(share > 0.005) || !Number.isFinite(alpha)) return '';
    const [c, s] = [-Math.cos(alpha), Math.sin(alpha)];
    const length = body.r * (0.25 + 1.6 * Math.min(share, 1.2));
    const wide = body.r * (0.12 + 0.2 * Math.min(share, 1));
    const from = body.r;
    const point = (along, side) => [along * c - side * s, along * s + side * c];
    return pointList([point(from, -wide * 0.5), point(from + length * 0.55, -wide),
      point(from + length, 0), point(from + length * 0.55, wide), point(from, wide * 0.5)]);
  }

  return { update, resize };
}

function arenaBox(scene, robots) {
  const xs = [], ys = [];
  if (scene.length !== null && scene.width !== null) { xs.push(0, scene.length); ys.push(0, scene.width); }
  for (const robot of robots) {
    for (const columns of [robot.planned, robot.measured]) {
      if (!columns) continue;
      xs.push(...columns.x.filter(Number.isFinite));
      ys.push(...columns.y.filter(Number.isFinite));
    }
  }
  if (!xs.length) { xs.push(0, 1); ys.push(0, 1); }
  const room = scene.length === null ? 0.3 : 0.05;
  return { left: Math.min(...xs) - room, right: Math.max(...xs) + room,
    bottom: Math.min(...ys) - room, top: Math.max(...ys) + room };
}

function overlap([left, top, right, bottom], other) {
  const wide = Math.min(right, other[2]) - Math.max(left, other[0]);
  const high = Math.min(bottom, other[3]) - Math.max(top, other[1]);
  return wide > 0 && high > 0 ? wide * high : 0;
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
  return String(Number(value.toFixed(6)));
}
