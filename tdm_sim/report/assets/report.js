// Start: draw the scene and the charts, connect them with one clock.
function startReport() {
  const report = JSON.parse(document.getElementById('report-data').textContent);
  const clock = new Clock(...report.span);
  connectControls(clock);

  const holder = document.getElementById('scene');
  const scene = report.scene && holder ? plantScene(report.scene, holder) : null;
  if (scene) {
    scene.resize();
    clock.listen((t) => scene.update(t));
  }
  const charts = chartSet(report.charts, clock);
  const ranges = { motion: report.motion, all: report.span };
  let part = 'motion';

  function choose(name) {
    part = name;
    choosePart(clock, ranges[name]);
    for (const button of document.querySelectorAll('[data-part]')) {
      button.setAttribute('aria-pressed', String(button.dataset.part === name));
    }
  }
  for (const button of document.querySelectorAll('[data-part]')) {
    button.addEventListener('click', () => {
      choose(button.dataset.part);
      charts.zoom(ranges[part], null);
      clock.set(clock.t);
    });
  }
  for (const button of document.querySelectorAll('[data-instant]')) {
    button.addEventListener('click', () => {
      const t = Number(button.dataset.instant);
      if (t < clock.start || t > clock.end) {
        choose('all');
        charts.zoom(ranges.all, null);
      }
      clock.pause();
      clock.set(t);
    });
  }
  choose('motion');
  const speed = document.getElementById('speed');
  speed.value = report.speed;
  clock.speed = Number(report.speed);

  function redraw() {
    if (scene) { scene.resize(); scene.update(clock.t); }
    charts.drawAll();
  }
  let width = document.documentElement.clientWidth;
  addEventListener('resize', () => {
    if (document.documentElement.clientWidth === width) return;
    width = document.documentElement.clientWidth;
    redraw();
  });
  matchMedia('(prefers-color-scheme: dark)').addEventListener('change', redraw);

  clock.set(Math.max(report.motion[0], 0));
  charts.drawAll(ranges.motion).then(() => {
    charts.connect(() => ranges[part]);
    window.report = { clock, charts, scene };
    document.documentElement.dataset.ready = 'true';
  });
}

startReport();
