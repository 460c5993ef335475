// Texts of a page that can be seen: how they begin, their size and ends [px].
const found = [];
for (const e of document.querySelectorAll('body *')) {
  const own = [...e.childNodes].some(n => n.nodeType === 3 && n.textContent.trim());
  const box = e.getBoundingClientRect();
  if (!own || !box.width || /^(SCRIPT|STYLE|OPTION)$/.test(e.tagName)) continue;
  if (!e.checkVisibility({visibilityProperty: true, opacityProperty: true})) continue;
  found.push([e.textContent.trim().slice(0, 40),
    parseFloat(getComputedStyle(e).fontSize), box.left, box.right]);
}
return found;
