// Time histories: plotly charts with linked zoom, linked legends and one cursor in all of them.
const NARROW = 700;  // px of the page below which it is laid out for a phone
const KINDS = { planned: 'planned', measured: 'measured', commanded: 'commanded', error: 'error', limit: 'limits',
  switching: 'switching points' };

// Measured curves are broad and pale; of a broad error, ripple would make a band.
const LINES = { planned: { width: 1.5 }, measured: { width: 3.5 }, commanded: { width: 1, dash: 'dot' },
  error: { width: 1 }, limit: { width: 1.3, dash: 'dash' }, switching: { width: 1, dash: 'dot' } };
// Shares of a panel's height that its title and the gap below it take.
const TITLE_SHARE = 0.17, FOOT_SHARE = 0.06;

// Colours of the page's scheme, dark or light.
function currentTheme() {
  const style = getComputedStyle(document.documentElement);
  const colour = (name) => style.getPropertyValue(`--${name}`).trim();
  return { text: colour('text'), grid: colour('grid'), faint: colour('faint'),
    limit: colour('limit'), switching: colour('soft'),
    series: Array.from({ length: 8 }, (_, k) => colour(`c${k}`)) };
}

function traceColour(theme, trace) {
  const { kind, colour } = trace.meta;
  return colour === undefined ? theme[kind] : theme.series[colour];
}

function chartSet(charts, clock) {
  const views = charts.map((chart) => chartView(chart, clock));
  const hidden = { kind: new Set(['commanded']), series: new Set() };
  let linking = false;

  // With a range [s] where it changes; else as zoomed.
  function drawAll(range = null) {
    const theme = currentTheme();
    return Promise.all(views.map((view) => view.draw(theme, range, hidden)));
  }

  function zoom(range, except) {
    linking = true;
    const done = views.filter((view) => view !== except)
      .map((view) => Plotly.relayout(view.node, { 'xaxis.range': range.slice() }));
    Promise.all(done).then(() => {
      linking = false;
      for (const view of views) view.cursor(clock.t);
    });
  }

  function toggle(group, name) {
    if (!hidden[group].delete(name)) hidden[group].add(name);
    drawAll();
  }

  function connect(initial) {
    for (const view of views) {
      view.addLegend(toggle, hidden);
      view.node.on('plotly_relayout', (change) => {
        if (linking) return;
        const low = change['xaxis.range[0]'], high = change['xaxis.range[1]'];
        if (low !== undefined) zoom([Number(low), Number(high)], view);
        else if (change['xaxis.range'] || change['xaxis.autorange']) zoom(initial(), null);
      });
    }
  }

  clock.listen((t) => views.forEach((view) => view.cursor(t)));
  return { drawAll, zoom, connect };
}

function chartView(chart, clock) {
  const node = document.getElementById(`chart-${chart.key}`);
  for (const trace of chart.data) { trace.x = unpack(trace.x); trace.y = unpack(trace.y); }
  const { panels } = chart;
  const overlay = document.createElement('div');
  overlay.className = 'overlay';
  const add = (className) =>
    overlay.appendChild(Object.assign(document.createElement('div'), { className }));
  const cursors = panels.map(() => add('cursor'));
  const readings = panels.map(() => add('reading'));
  const legend = [];
  let margin = {}, height = 0, drawn = false, theme = null;

  function layout(range) {
    const narrow = document.documentElement.clientWidth < NARROW;
    margin = { l: 54, r: 10, t: 4, b: 44 };
    height = margin.t + margin.b + panels.length * (narrow ? 132 : 150);
    const axis = { gridcolor: theme.grid, linecolor: theme.faint, tickcolor: theme.faint,
      tickfont: { size: 11 }, automargin: false, zeroline: false };
    const count = panels.length;
    const result = {
      width: node.clientWidth, height, margin, hovermode: false,
      showlegend: false,  // the page has its own, shared by all charts
      font: { family: getComputedStyle(document.body).fontFamily, size: 12, color: theme.text },
      paper_bgcolor: 'rgba(0,0,0,0)', plot_bgcolor: 'rgba(0,0,0,0)',
      dragmode: matchMedia('(pointer: coarse)').matches || narrow ? false : 'zoom',
      xaxis: { ...axis, anchor: 'free', position: 0,
        range: range ? range.slice() : node.layout.xaxis.range.slice(),
        title: { text: 'time from the start of the motion [s]', font: { size: 12 }, standoff: 8 } },
      annotations: panels.map((panel, k) => ({ text: panelTitle(panel, narrow), x: 0, y: 1 - k / count,
        xref: 'paper', yref: 'paper', xanchor: 'left', yanchor: 'top', showarrow: false, font: { size: 12.5 } })),
    };
    panels.forEach((panel, k) => {
      const key = `yaxis${k ? k + 1 : ''}`, top = 1 - k / count;
      result[key] = { ...axis, nticks: 5, exponentformat: 'power',
        domain: [Math.max(0, top - (1 - FOOT_SHARE) / count), top - TITLE_SHARE / count],
        range: drawn ? node.layout[key].range.slice() : panel.range };
    });
    return result;
  }

  function draw(colours, range, hidden) {
    theme = colours;
    const data = chart.data.map((trace) => ({ ...trace, type: 'scatter', mode: 'lines', hoverinfo: 'skip',
      line: { ...LINES[trace.meta.kind], shape: trace.meta.held ? 'hv' : 'linear', color: traceColour(theme, trace) },
      opacity: trace.meta.kind === 'measured' ? 0.5 : 1,
      visible: !hidden.kind.has(trace.meta.kind) && !hidden.series.has(trace.meta.series) }));
    const config = { displaylogo: false, responsive: false, doubleClick: 'reset',
      displayModeBar: false, showTips: false };
    paintLegend(hidden);
    return Plotly.react(node, data, layout(range), config).then(() => {
      if (!drawn) {
        drawn = true;
        node.appendChild(overlay);
        follow();
      }
      cursor(clock.t);
    });
  }

  // Kinds of curves that are there, and whose they are: each a button.
  function addLegend(toggle, hidden) {
    const list = document.createElement('ul');
    list.className = 'legend';
    const entries = new Map();
    for (const { meta } of node.data) {
      if (meta.series) entries.set(`series ${meta.series}`, { group: 'series', name: meta.series, meta });
    }
    for (const kind of Object.keys(KINDS)) {
      const trace = node.data.find(({ meta }) => meta.kind === kind);
      if (trace) entries.set(`kind ${kind}`, { group: 'kind', name: kind, meta: trace.meta });
    }
    for (const { group, name, meta } of entries.values()) {
      const button = Object.assign(document.createElement('button'), { type: 'button' });
      const swatch = document.createElement('span');
      swatch.className = `swatch ${group === 'series' ? 'series' : name}`;
      button.append(swatch, group === 'series' ? name : KINDS[name]);
      button.addEventListener('click', () => toggle(group, name));
      const item = document.createElement('li');
      item.appendChild(button);
      list.appendChild(item);
      legend.push({ button, swatch, group, name, meta });
    }
    list.classList.toggle('many', entries.size > 14);
    node.before(list);
    paintLegend(hidden);
  }

  function paintLegend(hidden) {
    for (const { button, swatch, group, name, meta } of legend) {
      button.setAttribute('aria-pressed', String(!hidden[group].has(name)));
      const one = group === 'kind' && meta.series && meta.colour !== undefined;
      swatch.style.setProperty('--colour', one ? theme.text : traceColour(theme, { meta }));
    }
  }

  function cursor(t) {
    if (!drawn) return;
    const [low, high] = node.layout.xaxis.range.map(Number);
    const inner = { width: node.layout.width - margin.l - margin.r,
      height: height - margin.t - margin.b };
    const share = (t - low) / (high - low);
    panels.forEach((panel, k) => {
      const [bottom, top] = node.layout[`yaxis${k ? k + 1 : ''}`].domain;
      show(cursors[k], share >= 0 && share <= 1);
      Object.assign(cursors[k].style, {
        transform: `translateX(${(margin.l + share * inner.width).toFixed(1)}px)`,
        top: `${margin.t + (1 - top) * inner.height}px`,
        height: `${(top - bottom) * inner.height}px`,
      });
      const line = margin.t + (1 - node.layout.annotations[k].y) * inner.height;
      Object.assign(readings[k].style, { top: `${line}px`, right: `${margin.r}px` });
      read(readings[k], k, t, inner.width);
    });
  }

  // The values at the cursor in the title's line, as many as there is room for.
  function read(element, panel, t, width) {
    const number = panel ? panel + 1 : '';
    const title = node.layout.annotations[panel].text.replace(/<[^>]*>/g, '');
    const room = Math.floor((width - 7.5 * title.length - 12) / 66);
    const [low, high] = node.layout[`yaxis${number}`].range.map(Number);
    const scale = Math.abs(high - low);
    let values = [];
    for (const trace of node.data) {
      const { kind } = trace.meta;
      const wanted = ['planned', 'measured', 'error'].includes(kind) && trace.visible !== false;
      if (!wanted || (trace.yaxis || 'y') !== `y${number}`) continue;
      const value = valueAt(trace.x, trace.y, t, trace.meta.held);
      if (Number.isFinite(value)) values.push({ value, kind, colour: traceColour(theme, trace) });
    }
    if (values.length > room) values = values.filter(({ kind }) => kind !== 'planned');
    if (values.length > room) values = [];
    element.replaceChildren(...values.map(({ value, kind, colour }) => {
      const span = document.createElement('span');
      span.className = kind;
      span.style.setProperty('--colour', colour);
      span.textContent = brief(value, scale);
      return span;
    }));
  }

  // Hovering, or drawing a finger across, moves the instant shown everywhere.
  function follow() {
    node.addEventListener('pointermove', (event) => {
      if (event.buttons && event.pointerType === 'mouse') return;  // a zoom box is being drawn
      const box = node.getBoundingClientRect();
      const share = (event.clientX - box.left - margin.l) / (box.width - margin.l - margin.r);
      if (share < 0 || share > 1 || clock.playing) return;
      const [low, high] = node.layout.xaxis.range.map(Number);
      clock.set(low + share * (high - low));
    });
  }

  return { node, draw, addLegend, cursor };
}

// The title as plotly writes it, which reads tags in texts.
function panelTitle({ title, description, unit }, narrow) {
  const escaped = (text) => text.replace(/&/g, '&amp;').replace(/</g, '&lt;').replace(/>/g, '&gt;');
  const words = description && !narrow ? ` ${description}` : '';
  return `<b>${escaped(title)}</b>${escaped(words + (unit ? ` [${unit}]` : ''))}`;
}

// A value as briefly as its axis can tell it: what cannot be seen on the axis' scale is 0.
function brief(value, scale) {
  const size = Math.abs(value);
  if (size < scale / 5000) return '0';
  const digits = size >= 100 ? 0 : size >= 10 ? 2 : size >= 0.1 || size === 0 ? 3 : 4;
  const text = size !== 0 && size < 1e-4 ? size.toExponential(1) : size.toFixed(digits);
  return (value < 0 && Number(text) !== 0 ? '−' : '') + text;
}

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
