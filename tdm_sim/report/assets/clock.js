// The one instant that animation, slider and cursors share.
class Clock {
  constructor(start, end) {
    this.listeners = [];
    this.speed = 1;
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
    this.set(this.t + this.speed * elapsed);
    if (this.t >= this.end - 1e-9) this.pause();
    else requestAnimationFrame((next) => this.tick(next));
  }
}

// The bar at the foot of the page: play, slider, speed, and what part of the time is shown.
function connectControls(clock) {
  const button = document.getElementById('play');
  const slider = document.getElementById('time');
  const label = document.getElementById('instant');
  const speed = document.getElementById('speed');
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
  speed.addEventListener('change', () => { clock.speed = Number(speed.value); });
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
