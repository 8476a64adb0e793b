'use strict';
document.documentElement.classList.add('js');

// The slider: places 0 to n - 1 are steps, place n is the result.
for (const view of document.querySelectorAll('.view')) {
  const slider = view.querySelector('.steps input');
  if (!slider) continue;
  const frames = [...view.querySelectorAll('.frames path[data-label]')];
  const halo = view.querySelector('.frames .halo');
  const told = view.querySelector('.steps output');
  const play = view.querySelector('.steps button');
  let timer = 0;
  const show = (place) => {
    place = Math.min(Math.max(place, 0), frames.length);
    slider.value = place;
    view.dataset.step = place;
    view.classList.toggle('moving', place < frames.length);
    frames.forEach((path, number) => path.classList.toggle('shown', number === place));
    halo.classList.toggle('shown', place < frames.length);
    halo.setAttribute('d', place < frames.length ? frames[place].getAttribute('d') : '');
    told.textContent = place < frames.length ? frames[place].dataset.label : 'result';
    slider.setAttribute('aria-valuetext', told.textContent);
  };
  const stop = () => { clearInterval(timer); timer = 0; play.textContent = '\u25b6'; };
  const start = () => {
    if (+slider.value >= frames.length) show(0);
    play.textContent = '\u275a\u275a';
    timer = setInterval(() => {
      show(+slider.value + 1);
      if (+slider.value >= frames.length) stop();
    }, Math.min(Math.max(3000 / frames.length, 90), 500));
  };
  slider.addEventListener('input', () => { stop(); show(+slider.value); });
  play.addEventListener('click', () => (timer ? stop() : start()));
  const follow = () => {
    const asked = /(?:^#|&)step=(\d+)/.exec(location.hash);
    if (asked) show(+asked[1]);
  };
  addEventListener('hashchange', follow);
  show(frames.length);
  follow();
}

// Enlarging: a double click at a place, with the shift key back again; then the picture can be dragged.
for (const svg of document.querySelectorAll('.view svg')) {
  const whole = svg.viewBox.baseVal, width = whole.width, height = whole.height;
  let box = [0, 0, width, height];
  const put = (x, y, w) => {
    w = Math.min(Math.max(w, width / 64), width);
    const h = w * height / width;
    box = [Math.min(Math.max(x, 0), width - w), Math.min(Math.max(y, 0), height - h), w, h];
    svg.setAttribute('viewBox', box.join(' '));
    svg.classList.toggle('zoomed', w < width);
  };
  svg.addEventListener('dblclick', (event) => {
    event.preventDefault();
    const frame = svg.getBoundingClientRect(), factor = event.shiftKey ? 2 : 0.5;
    const s = (event.clientX - frame.left) / frame.width, t = (event.clientY - frame.top) / frame.height;
    put(box[0] + s * box[2] * (1 - factor), box[1] + t * box[3] * (1 - factor), box[2] * factor);
  });
  svg.addEventListener('pointerdown', (event) => {
    if (box[2] >= width) return;
    const from = [event.clientX, event.clientY, ...box], scale = box[2] / svg.getBoundingClientRect().width;
    svg.setPointerCapture(event.pointerId);
    const move = (now) => put(from[2] - (now.clientX - from[0]) * scale, from[3] - (now.clientY - from[1]) * scale, from[4]);
    svg.addEventListener('pointermove', move);
    svg.addEventListener('pointerup', () => svg.removeEventListener('pointermove', move), { once: true });
  });
}
