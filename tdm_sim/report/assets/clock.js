// The one instant that animation, slider and cursors share.
class Clock {
  constructor(start, end) {
    this.listeners = [];
    this.speed = 1;
    this.playing = false;
    this.setRange(start, end);
    this.t = start;
  }

  setRange(start, end) {
    this.start = start;
    this.end = end;
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
    this.changed();
  }

  pause() {
    this.playing = false;
    this.changed();
  }

  tick(now) {
    if (!this.playing) return;
    const elapsed = Math.min(Math.max(now - this.last, 0), 250) / 1000;
    this.last = now;
    this.set(this.t + this.speed * elapsed);
    if (this.t >= this.end - 1e-9) this.pause();
    else requestAnimationFrame((next) => this.tick(next));
  }

  changed() {
    if (this.onChange) this.onChange(this.playing);
  }
}

// The bar at the foot of the page: play, slider, speed, and what part of the time is shown.
function connectControls(clock, format) {
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
    label.textContent = format(t);
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

function fitSlider(clock) {
  const slider = document.getElementById('time');
  slider.min = clock.start;
  slider.max = clock.end;
  slider.step = (clock.end - clock.start) / 1000 || 0.001;
}
