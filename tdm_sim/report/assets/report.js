const PLAYED_IN = 8; // s

// The one instant that animation, slider and cursors share.
class Clock {
  constructor(start, end) {
    this.listeners = [];
    this.playing = false;
    this.onChange = () => {};
    Object.assign(this, { start, end, t: start });
  }

  listen(listener) {
    this.listeners.push(listener);
  }

  set(t) {
    this.t = Math.min(Math.max(t, this.start), this.end);
    for (const listener of this.listeners) listener(this.t);
  }

  play() {
    if (this.playing) return;
    if (this.t >= this.end - 1e-9) this.set(this.start);
    this.playing = true;
    this.last = performance.now();
    requestAnimationFrame((now) => this.tick(now));
    this.onChange(true);
  }

  pause() {
    this.playing = false;
    this.onChange(false);
  }

  tick(now) {
    if (!this.playing) return;
    const elapsed = Math.min(Math.max(now - this.last, 0), 250) / 1000;
    this.last = now;
    this.set(this.t + elapsed * (this.end - this.start) / PLAYED_IN);
    if (this.t >= this.end - 1e-9) this.pause();
    else requestAnimationFrame((next) => this.tick(next));
  }
}

// The bar at the foot of the page: play, slider, and what part of the time is shown.
function connectControls(clock) {
  const button = document.getElementById('play');
  const slider = document.getElementById('time');
  const label = document.getElementById('instant');
  clock.onChange = (playing) => {
    button.dataset.state = playing ? 'playing' : 'paused';
    button.setAttribute('aria-label', playing ? 'Pause' : 'Play');
  };
  clock.listen((t) => {
    slider.value = t;
    label.textContent = `${t < -5e-4 ? '−' : ''}${Math.abs(t).toFixed(2)} s`;
    slider.setAttribute('aria-valuetext', label.textContent);
    const share = (t - clock.start) / ((clock.end - clock.start) || 1);
    slider.style.setProperty('--share', `${(100 * share).toFixed(2)}%`);
  });
  button.addEventListener('click', () => (clock.playing ? clock.pause() : clock.play()));
  slider.addEventListener('input', () => {
    if (clock.playing) clock.pause();
    clock.set(Number(slider.value));
  });
  document.addEventListener('keydown', (event) => {
    const typing = /^(INPUT|SELECT|BUTTON|SUMMARY|A)$/.test(event.target.tagName);
    if (event.key === ' ' && !typing) {
      event.preventDefault();
      button.click();
    }
  });
  clock.onChange(false);
}

// Show a part of the time.
function choosePart(clock, [start, end]) {
  Object.assign(clock, { start, end });
  const slider = document.getElementById('time');
  Object.assign(slider, { min: start, max: end, step: (end - start) / 1000 || 0.001 });
}

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
