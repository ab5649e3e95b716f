// The technique pyramid of the picture.

export default function (host) {
  const { make } = host;
  const show = make('button', { type: 'button', click: () => host.send('show') }, 'Show');
  const about = make('p', { class: 'soft' });
  host.element.append(about, make('div', {}, show));
  host.onState((state) => {
    const { there } = state.panels.pyramid;
    show.disabled = !there;
    about.textContent = there ? 'What each way of making paths adds to the picture.' : 'Choose bpt, bpm or vcm, and set pyramid among its settings.';
  });
  const figure = (shown) => (shown ? make('figure', {}, make('img', { src: shown.source, alt: shown.alt }),
    make('figcaption', {}, `${shown.name} `, make('span', { class: 'soft' }, shown.caption))) : '');
  host.on('shown', ({ views }) => {
    const { element } = host.page('Technique pyramid');
    element.className = 'pyramid';
    for (const view of views) {
      element.append(make('h2', {}, view.title));
      for (const { heading, columns, rows } of view.triangles) {
        element.append(make('h3', {}, heading), make('div', { class: 'scroll' }, make('table', {},
          make('thead', {}, make('tr', {}, make('td'), ...columns.map((s) => make('th', { scope: 'col' }, `s = ${s}`)))),
          make('tbody', {}, ...rows.map(([edges, row]) => make('tr', {}, make('th', { scope: 'row' }, `${edges} ${edges === 1 ? "edge" : "edges"}`), ...row.map((one) => make('td', {}, figure(one)))))))));
      }
      if (view.longer) element.append(figure(view.longer));
    }
  });
}
