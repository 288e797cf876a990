(function () {
  var box = document.getElementById('zoom'), picture = box.querySelector('img'), words = box.querySelector('p');
  document.addEventListener('click', function (event) {
    var button = event.target.closest('figure button');
    if (button) {
      picture.src = button.querySelector('img').src;
      picture.alt = button.querySelector('img').alt;
      words.textContent = picture.alt;
      box.showModal();
    } else if (box.open) { box.close(); }
  });
  var links = {};
  document.querySelectorAll('nav a').forEach(function (link) { links[link.hash.slice(1)] = link; });
  var names = Object.keys(links), waiting = false;
  function mark() {
    var root = document.documentElement, here = names[0], edge = 0.3 * window.innerHeight;
    var atEnd = window.scrollY > 0 ? window.scrollY + window.innerHeight + 2 >= root.scrollHeight : false;
    waiting = false;
    names.forEach(function (id) {
      if (atEnd || edge >= document.getElementById(id).getBoundingClientRect().top) { here = id; }
    });
    names.forEach(function (id) { links[id].classList.toggle('here', id === here); });
  }
  function later() {
    if (!waiting) { waiting = true; window.requestAnimationFrame(mark); }
  }
  ['scroll', 'resize', 'load'].forEach(function (kind) { window.addEventListener(kind, later, { passive: true }); });
  mark();
})();
