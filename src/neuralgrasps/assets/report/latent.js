(function () {
  // The latent maps. As in page.js, no character that XML would take for markup.
  document.querySelectorAll('.latent').forEach(function (card) {
    var plot = card.querySelector('.plot'), said = card.querySelector('.said'), shown = card.querySelector('.shown');
    var marks = Array.from(card.querySelectorAll('.mark')), here = null, held = null;
    marks.forEach(function (mark) {
      var at = mark.dataset.at.split(' ');
      mark.place = [Number(at[0]), Number(at[1])];
    });
    function thumb(letter) {
      return letter ? card.querySelector('.thumbs [data-letter="' + letter + '"]') : null;
    }
    function show(mark) {
      var old = here ? thumb(here.dataset.letter) : null, now = thumb(mark.dataset.letter);
      if (here) { here.classList.remove('here'); }
      if (old) { old.classList.remove('here'); }
      here = mark;
      mark.classList.add('here');
      shown.textContent = '';
      if (now) {
        now.classList.add('here');
        shown.appendChild(now.querySelector('img').cloneNode());
      }
      said.textContent = mark.querySelector('title').textContent + (now ? ' (' + mark.dataset.letter + ')' : '');
    }
    function markOf(event) {
      var mark = event.target.closest ? event.target.closest('.mark') : null;
      return mark ? mark : null;
    }
    plot.addEventListener('mouseover', function (event) {
      var mark = markOf(event);
      if (mark) { if (!held) { show(mark); } }
    });
    plot.addEventListener('click', function (event) {
      var mark = markOf(event);
      held = mark === held ? null : mark;
      if (mark) { show(mark); }
    });
    card.querySelectorAll('.thumbs [data-letter]').forEach(function (box) {
      function point() {
        var mark = card.querySelector('.mark[data-letter="' + box.dataset.letter + '"]');
        if (mark) { show(mark); }
      }
      box.addEventListener('mouseover', point);
      box.addEventListener('focusin', point);
    });
    var steps = { ArrowRight: [1, 0], ArrowLeft: [-1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    function next(step) {
      var best = null, cost = Infinity;
      marks.forEach(function (mark) {
        if (mark.classList.contains('off')) { return; }
        var dx = mark.place[0] - here.place[0], dy = mark.place[1] - here.place[1];
        var along = dx * step[0] + dy * step[1], across = Math.abs(dx * step[1]) + Math.abs(dy * step[0]);
        if (along > 0.05) { if (cost > along + 2.5 * across) { best = mark; cost = along + 2.5 * across; } }
      });
      return best;
    }
    plot.addEventListener('keydown', function (event) {
      var step = steps[event.key], visible = marks.filter(function (mark) { return !mark.classList.contains('off'); });
      if (event.key === 'Escape') { held = null; }
      if (event.key === 'Enter') {
        var box = here ? thumb(here.dataset.letter) : null;
        if (box) { box.querySelector('button').click(); }
      }
      if (!step) { return; }
      event.preventDefault();
      if (!visible.length) { return; }
      if (!here || here.classList.contains('off')) { show(visible[0]); return; }
      var mark = next(step);
      if (mark) { show(mark); }
    });
    var first = marks.find(function (mark) { return mark.dataset.letter; });
    if (first) { show(first); }
  });
  document.querySelectorAll('.legend.toggles button').forEach(function (button) {
    button.addEventListener('click', function () {
      var on = button.getAttribute('aria-pressed') !== 'true', name = button.dataset.hand;
      button.setAttribute('aria-pressed', String(on));
      document.querySelectorAll('.latent [data-hand]').forEach(function (mark) {
        if (mark.dataset.hand === name) { mark.classList.toggle('off', !on); }
      });
    });
  });
})();
