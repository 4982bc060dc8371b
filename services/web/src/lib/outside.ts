/** Closes an opened `details` by a click elsewhere, as menus do. */
export function closesOutside(details: HTMLDetailsElement): { destroy(): void } {
  const close = (event: MouseEvent): void => {
    if (details.open && !event.composedPath().includes(details)) details.open = false;
  };
  window.addEventListener("click", close);
  return { destroy: () => window.removeEventListener("click", close) };
}
