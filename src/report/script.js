// Sliders between two pictures, and which two these are.
'use strict';
for (const widget of document.querySelectorAll('.compare')) {
  for (const stack of widget.querySelectorAll('.stack')) {
    const range = stack.querySelector('input');
    range.addEventListener('input', () => stack.style.setProperty('--at', range.value + '%'));
  }
  for (const button of widget.querySelectorAll('button')) {
    const { side, choice } = button.dataset;
    button.addEventListener('click', () => {
      for (const other of widget.querySelectorAll(`button[data-side=${side}]`)) {
        other.setAttribute('aria-pressed', String(other === button));
      }
      for (const picture of widget.querySelectorAll('img')) {
        picture.classList.toggle(side, picture.dataset.choice === choice);
      }
      for (const tag of widget.querySelectorAll(`.tag[data-side=${side}]`)) {
        tag.textContent = button.textContent;
      }
    });
  }
}
