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
  if ('IntersectionObserver' in window) {
    var watch = new IntersectionObserver(function (entries) {
      entries.forEach(function (entry) {
        if (entry.isIntersecting) {
          Object.values(links).forEach(function (link) { link.classList.remove('here'); });
          links[entry.target.id].classList.add('here');
        }
      });
    }, { rootMargin: '-20% 0px -70% 0px' });
    Object.keys(links).forEach(function (id) { watch.observe(document.getElementById(id)); });
  }
})();
