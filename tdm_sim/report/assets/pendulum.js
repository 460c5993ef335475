// The pendulum from the side and from above, in the frame of the markers: origin in the disk's
// centre, z up, psi about z from x, theta from upright. Both views have y to the right; seen from
// the side x points at the reader, seen from above it points down.
function pendulumPose(scene, theta, psi) {
  const pivot = [scene.arm * Math.cos(psi), scene.arm * Math.sin(psi), 0];
  const across = scene.rod * Math.sin(theta);
  const tip = [
    pivot[0] - across * Math.sin(psi),
    pivot[1] + across * Math.cos(psi),
    scene.rod * Math.cos(theta),
  ];
  return { pivot, tip };
}

function pendulumScene(scene, holder) {
  const motion = { planned: unpackColumns(scene.planned), measured: unpackColumns(scene.measured) };
  const times = unpack(scene.times);
  const reach = Math.hypot(scene.arm, scene.rod);
  const tips = {};
  for (const [kind, columns] of Object.entries(motion)) {
    if (!columns) continue;
    tips[kind] = Array.from(columns.theta, (theta, k) =>
      (Number.isFinite(theta) ? pendulumPose(scene, theta, columns.psi[k]).tip : null));
  }
  const views = [
    pendulumView(scene, holder, 'side', reach, ([, y, z]) => [y, -z]),
    pendulumView(scene, holder, 'top', reach, ([x, y]) => [y, x]),
  ];
  const readings = document.createElement('p');
  readings.className = 'readings';
  holder.after(readings);

  function update(t) {
    const index = indexAt(times, t);
    for (const view of views) {
      for (const [kind, columns] of Object.entries(motion)) {
        if (!columns) continue;
        const theta = valueAt(times, columns.theta, t);
        const psi = valueAt(times, columns.psi, t);
        const torque = valueAt(times, columns.torque, t);
        view.move(kind, theta, psi, torque, tips[kind].slice(0, index + 1));
      }
    }
    const known = (columns) => columns && Number.isFinite(valueAt(times, columns.theta, t));
    const now = known(motion.measured) ? motion.measured : motion.planned || motion.measured;
    readings.textContent = [['theta', 'θ', 'rad', 3], ['psi', 'ψ', 'rad', 3],
      ['torque', 'T', 'N m', 4]].map(([name, symbol, unit, digits]) => {
      const value = valueAt(times, now[name], t);
      const said = Number.isFinite(value) ? `= ${signed(value, digits)} ${unit}` : '–';
      return `${symbol} ${said}`.replace(/ /g, '\u00a0');  // lines break between readings only
    }).join('   ');
  }

  function resize() {
    for (const view of views) view.layOut(motion, tips);
  }
  return { update, resize };
}

function signed(value, digits) {
  return (value < 0 ? '−' : '+') + Math.abs(value).toFixed(digits);
}

function pendulumView(scene, holder, name, reach, project) {
  const figure = document.createElement('figure');
  const svg = draw(figure, 'svg', { id: `pendulum-${name}`, role: 'img',
    'aria-label': `pendulum, ${name} view` });
  const caption = document.createElement('figcaption');
  caption.textContent = `${name} view`;
  figure.appendChild(caption);
  holder.appendChild(figure);
  let scale = 1, centre = 0, bodies = {};
  const at = (point) => {
    const [right, down] = project(point);
    return [centre + scale * right, centre + scale * down];
  };

  function layOut(motion, tips) {
    const size = Math.max(120, Math.min(360, Math.floor(figure.clientWidth)));
    centre = size / 2;
    scale = (centre - 14) / (reach * 1.04);
    svg.replaceChildren();
    place(svg, { viewBox: `0 0 ${size} ${size}`, height: size, width: size, 'data-scale': scale });
    drawRig();
    if (tips.planned) {
      const path = tips.planned.filter(Boolean).map(at);
      draw(svg, 'polyline', { class: 'rig planned path', points: pointList(path) });
      const [x, y] = path[path.length - 1];
      draw(svg, 'circle', { class: 'destination', cx: x, cy: y, r: 6 });
    }
    bodies = {};
    for (const kind of ['planned', 'measured']) if (motion[kind]) bodies[kind] = drawBody(kind);
  }

  function drawRig() {
    const radius = scale * scene.arm;
    if (name === 'side') {
      draw(svg, 'line', { class: 'axis', x1: 6, x2: 2 * centre - 6, y1: centre, y2: centre });
      draw(svg, 'rect', { class: 'base', x: centre - radius / 3, width: 2 * radius / 3,
        y: centre, height: centre - 14, rx: 3 });
      draw(svg, 'rect', { class: 'disk', x: centre - radius, width: 2 * radius,
        y: centre - 4, height: 8, rx: 3 });
      return;
    }
    draw(svg, 'circle', { class: 'disk', cx: centre, cy: centre, r: radius });
    if (scene.diskLimit === null) return;
    const limit = scene.diskLimit;
    const ring = [];
    const outer = scene.arm * 1.12;
    const turn = Math.min(limit, Math.PI);
    for (let k = 0; k <= 60; k++) {
      const angle = -turn + (2 * turn * k) / 60;
      ring.push(at([outer * Math.cos(angle), outer * Math.sin(angle), 0]));
    }
    draw(svg, 'polyline', { class: 'limit', points: pointList(ring) });
    if (limit >= Math.PI) return;
    for (const angle of [-limit, limit]) {
      const [inner, stop] = [scene.arm * 1.04, scene.arm * 1.2].map((r) =>
        at([r * Math.cos(angle), r * Math.sin(angle), 0]));
      draw(svg, 'line', { class: 'limit stop', x1: inner[0], y1: inner[1],
        x2: stop[0], y2: stop[1] });
    }
  }

  function drawBody(kind) {
    const group = draw(svg, 'g', { class: `rig ${kind}` });
    return {
      group,
      trail: kind === 'measured' ? draw(group, 'path', { class: 'trail' }) : null,
      arm: draw(group, 'line', { class: 'arm' }),
      torque: name === 'top' ? draw(group, 'path', { class: 'torque' }) : null,
      rod: draw(group, 'line', { class: 'rod' }),
      pivot: draw(group, 'circle', { class: 'pivot', r: 4 }),
      tip: draw(group, 'circle', { class: 'tip', r: kind === 'measured' ? 6 : 5 }),
    };
  }

  function move(kind, theta, psi, torque, trail) {
    const body = bodies[kind];
    if (!body) return;
    show(body.group, Number.isFinite(theta) && Number.isFinite(psi));
    if (!Number.isFinite(theta) || !Number.isFinite(psi)) return;
    const { pivot, tip } = pendulumPose(scene, theta, psi);
    const [px, py] = at(pivot), [x, y] = at(tip);
    place(body.arm, { x1: centre, y1: centre, x2: px, y2: py });
    place(body.rod, { x1: px, y1: py, x2: x, y2: y });
    place(body.pivot, { cx: px, cy: py });
    place(body.tip, { cx: x, cy: y });
    if (body.trail) place(body.trail, { d: way(trail.map((tip) => tip && at(tip))) });
    if (body.torque) place(body.torque, { d: torqueArrow(psi, torque) });
  }

  // An arc inside the disk from the arm onwards, a quarter turn at the limit.
  function torqueArrow(psi, torque) {
    const share = torque / (scene.torqueLimit || Math.abs(torque) || 1);
    if (!(Math.abs(share) > 0.02)) return '';
    const radius = scene.arm * 0.62;
    const sweep = share * Math.PI / 2;
    const on = (angle, r) => at([r * Math.cos(angle), r * Math.sin(angle), 0])
      .map((v) => v.toFixed(1)).join(' ');
    const head = Math.sign(sweep) * Math.min(0.18, Math.abs(sweep));
    const end = psi + sweep;
    // seen with y to the right and x down, psi grows against the clock
    const turn = sweep > 0 ? 0 : 1;
    const r = (scale * radius).toFixed(1);
    return `M ${on(psi, radius)} A ${r} ${r} 0 0 ${turn} ${on(end, radius)}`
      + ` M ${on(end - head, radius * 0.86)} L ${on(end, radius)} L ${on(end - head, radius * 1.14)}`;
  }

  return { layOut, move };
}
