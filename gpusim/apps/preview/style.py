"""Layout and colours of the preview's page."""

# Wide: the picture, its tools and panels on the left, controls on the right; panels and controls scroll alone. Narrow:
# one column that scrolls under the picture. A control that glides to its new place has the page laid out and painted
# at every refresh of the screen.
STYLE = """
:root {
    --gp-back: #fafafa; --gp-text: #1c1c1c; --gp-quiet: #555; --gp-line: #bbb; --gp-wrong: #b3261e;
    --gp-busy: #8a5a00; --gp-curve: #8a6d00; --gp-high: 52dvh;
}
body.body--dark {
    --gp-back: #171717; --gp-text: #e8e8e8; --gp-quiet: #b0b0b0; --gp-line: #555; --gp-wrong: #ff8a80;
    --gp-busy: #ffca5c; --gp-curve: #ffd54f;
}
body { background: var(--gp-back); color: var(--gp-text); }
.nicegui-content { padding: 0; }
.gp-page {
    display: grid; width: 100%; height: 100dvh; column-gap: 12px;
    grid-template-columns: minmax(0, 1fr) minmax(340px, 410px);
    grid-template-rows: auto auto auto minmax(0, 1fr);
}
.gp-head, .gp-stage, .gp-tools, .gp-below { grid-column: 1; padding: 2px 8px; min-width: 0; }
.gp-side { grid-column: 2; grid-row: 1 / 5; overflow-y: auto; padding: 4px 8px; overscroll-behavior: contain; }
.gp-below { overflow-y: auto; }
.gp-picture {
    position: relative; margin: 0 auto;
    width: min(100%, calc(var(--gp-high) * var(--gp-aspect, 1.5)));
}
.gp-captions {
    position: absolute; inset: 0 0 auto; display: flex; justify-content: space-between; pointer-events: none;
    font-size: 12px; color: #fff;
}
.gp-captions > * > * { width: fit-content; padding: 2px 6px; background: rgb(0 0 0 / 65%); overflow-wrap: anywhere; }
.gp-bar { display: flex; align-items: center; gap: 4px; overflow-x: auto; }
.gp-title { font-size: 1rem; line-height: 1.3; font-weight: 500; flex-grow: 1; margin: 0; }
body.body--light :is(.gp-page, .q-dialog, .q-menu) { --q-primary: #1565c0; }
.q-tooltip { background: #222; color: #fff; }
.gp-bar > * { flex-shrink: 0; }
.gp-known { font: 12px/1.35 monospace; color: var(--gp-text); white-space: pre-wrap; overflow-wrap: anywhere; }
.gp-quiet { font-size: 12px; color: var(--gp-quiet); }
.gp-wrong { color: var(--gp-wrong); font-size: 13px; }
.gp-busy { color: var(--gp-busy); font-size: 13px; }
.gp-row { display: flex; width: 100%; align-items: center; gap: 8px; min-height: 32px; }
.gp-side .nicegui-expansion-content { gap: 0; padding: 0 4px 4px; }
.gp-row .gp-name { width: 7.5rem; flex-shrink: 0; font-size: 13px; line-height: 1.15; }
.gp-row .gp-changed { font-weight: 700; }
.gp-row .q-field__messages { color: var(--gp-wrong); }
.q-slider *, .q-field, .q-field *, .q-checkbox *, .q-focus-helper {
    transition: none !important; animation: none !important;
}
:focus-visible { outline: 2px solid #4a90d9; outline-offset: 1px; }
@media (max-width: 1100px), (orientation: portrait) {
    :root { --gp-high: 38dvh; }
    .gp-page { display: block; height: auto; }
    .gp-stage { position: sticky; top: 0; z-index: 5; background: var(--gp-back); }
    .gp-side, .gp-below { overflow: visible; }
    html { scroll-padding-top: 42dvh; }
}
"""
