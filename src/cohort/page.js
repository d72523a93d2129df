document.querySelectorAll('#cases thead th').forEach((heading, column) => {
  const button = heading.querySelector('button');
  if (!button) return;
  button.addEventListener('click', () => {
    const down = heading.getAttribute('aria-sort') === 'ascending';
    document.querySelectorAll('#cases th[aria-sort]').forEach(h => h.removeAttribute('aria-sort'));
    heading.setAttribute('aria-sort', down ? 'descending' : 'ascending');
    const body = document.querySelector('#cases tbody');
    const key = row => {
      const cell = row.children[column];
      if ('value' in cell.dataset) return Number(cell.dataset.value);
      return cell.classList.contains('none') ? null : cell.textContent;
    };
    const rows = [...body.rows].map(row => [key(row), row]);
    rows.sort(([a], [b]) => {
      if (a === null || b === null) return (a === null) - (b === null);
      const order = typeof a === 'number' ? a - b : a.localeCompare(b, 'en', { numeric: true });
      return down ? -order : order;
    });
    body.append(...rows.map(([, row]) => row));
  });
});
