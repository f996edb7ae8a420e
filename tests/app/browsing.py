"""What the browser tests and the benchmark ask of a page."""

import math

READY = "window.Bokeh && Bokeh.documents.length && Bokeh.documents[0].roots().length"
PREPARED = """(() => { const d = Bokeh.documents[0]; const s = d.get_model_by_name('pictures');
 return s.data['sphere true'][0].length > 100 && d.get_model_by_name('plan-status').text === '' })()"""
EXACT = "Bokeh.documents[0].get_model_by_name('plan-numbers').text.includes('matcam predict')"

# The boxes of all widgets and plots that are shown, as [name, left, top, right, bottom, overflow]
BOXES = """(() => {
  const found = [];
  const walk = (view) => {
    if (!view.model.visible) return;
    if (['Row', 'Column'].includes(view.model.type) && view.child_views) { view.child_views.forEach(walk); return }
    const r = view.el.getBoundingClientRect();
    if (r.width && r.height && !(view.model.type === 'Div' && !view.model.text))
      { const m = view.model; found.push([String(m.name || m.title?.text || m.text || m.type), r.left,
                  r.top, r.right, r.bottom,
                  view.model.type === 'Div' ? view.el.scrollWidth - view.el.clientWidth : 0]) }
  };
  Object.values(Bokeh.index.roots || Bokeh.index).forEach(walk);
  return found;
})()"""

# One move of a slider: until curve and pictures have arrived and the frame that shows them has been drawn, ms
MOVE = """async ([name, place, sources]) => {
  const d = Bokeh.documents[0];
  const waits = sources.map((one) => new Promise((done) => {
    const model = d.get_model_by_name(one);
    const seen = () => { model.properties.data.change.disconnect(seen); done() };
    model.properties.data.change.connect(seen);
  }));
  const start = performance.now();
  d.get_model_by_name(name).value = place;
  await Promise.all(waits);
  await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
  return performance.now() - start;
}"""
# Many moves of a slider, in bursts, and what arrives of them until all is still: the values whose fast curves are shown, how
# many of them came after the server had answered the last move, and the value that number field and slider have in the end
DRAG = """async ([name, places, burst, pause]) => {
  const d = Bokeh.documents[0];
  const slider = d.get_model_by_name(name), field = d.get_model_by_name(name.replace('slider', 'field'));
  const curve = d.get_model_by_name('curve');
  const wait = (ms) => new Promise((done) => setTimeout(done, ms));
  let last = performance.now(), answered = 0, late = 0;
  const shown = [];
  const echo = () => { last = performance.now(); answered += 1; late = 0 };
  const draw = () => {
    last = performance.now();
    if (curve.data.theta[0].length < 100) { shown.push(Number(curve.data.chosen[0])); late += 1 }
  };
  field.properties.value.change.connect(echo);
  curve.properties.data.change.connect(draw);
  for (let i = 0; i < places.length; i++) { slider.value = places[i]; if (i % burst == burst - 1) await wait(pause) }
  last = performance.now();
  while (performance.now() - last < 3000) await wait(20);
  field.properties.value.change.disconnect(echo);
  curve.properties.data.change.disconnect(draw);
  return { shown, late, answered, value: field.value, slider: slider.value };
}"""

SHOWN = ["curve", "pictures"]

FOCUSED = """(() => {
  let one = document.activeElement;
  const path = [];
  while (one) { const host = one; path.push(host); one = one.shadowRoot ? one.shadowRoot.activeElement : null }
  const names = [];
  const walk = (view) => {
    if (path.includes(view.el)) names.push(String(view.model.name || view.model.type));
    (view.child_views || []).forEach(walk);
  };
  Object.values(Bokeh.index.roots || Bokeh.index).forEach(walk);
  return names.length ? names[names.length - 1] : '';
})()"""


def faults(boxes, width):
    """What is clipped at the window's sides, or overlaps."""
    found = [f"{name} leaves the window" for name, left, _, right, *_ in boxes if left < -1 or right > width + 1]
    found += [f"{name} is clipped" for name, *_, overflow in boxes if overflow > 1]
    for i, (a, l0, t0, r0, b0, _) in enumerate(boxes):
        for b, l1, t1, r1, b1, _ in boxes[i + 1 :]:
            if min(r0, r1) - max(l0, l1) > 2 and min(b0, b1) - max(t0, t1) > 2:
                found.append(f"{a} overlaps {b}")
    return found


def latencies(page, moves=60, slider="slider-roughness", low=-2.7, high=-0.7):
    """Times from a slider's event to the paint of curve and pictures, ms."""
    positions = [low + (high - low) * (0.5 + 0.5 * math.sin(0.37 * i)) for i in range(moves)]
    return [page.evaluate(MOVE, [slider, position, SHOWN]) for position in positions]
