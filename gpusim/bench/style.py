"""The style sheet of pages: light, and dark if the reader's system is."""

STYLE = """
:root { color-scheme: light dark;
  --page: #ffffff; --panel: #f5f6f8; --text: #1b1f26; --quiet: #5b6470; --line: #d9dde3;
  --slower: #b4380b; --faster: #1d4ed8; --same: #5b6470; --wrong: #9b1c5a; --unknown: #7a5c00; }
@media (prefers-color-scheme: dark) { :root {
  --page: #14171c; --panel: #1e232b; --text: #e6e9ee; --quiet: #a2abb8; --line: #353c47;
  --slower: #ff9466; --faster: #8ab4ff; --same: #a2abb8; --wrong: #ff86bd; --unknown: #e3c04d; } }
* { box-sizing: border-box; }
body { margin: 0; background: var(--page); color: var(--text);
  font: 14px/1.45 system-ui, "Segoe UI", Roboto, "DejaVu Sans", sans-serif; }
main { padding: 24px; }
h1 { font-size: 22px; margin: 0 0 16px; }
h2 { font-size: 15px; margin: 0 0 4px; }
.cards { display: flex; flex-wrap: wrap; gap: 12px; }
.cards section { flex: 1 1 320px; background: var(--panel); border: 1px solid var(--line);
  border-radius: 8px; padding: 12px 14px; }
.cards p { margin: 0; color: var(--quiet); overflow-wrap: anywhere; }
.cards ul { margin: 8px 0 0; padding-left: 18px; }
.warning { color: var(--slower); }
.legend { color: var(--quiet); max-width: 110ch; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; white-space: nowrap; }
th, td { padding: 3px 10px; text-align: right; border-bottom: 1px solid var(--line); }
thead th { text-align: right; color: var(--quiet); font-weight: 600; }
thead tr:first-child th { text-align: left; color: var(--text); }
th[scope=row], td.why, thead th.first { text-align: left; }
th[scope=row] { font-weight: 400; position: sticky; left: 0; background: var(--page); }
.first { border-left: 1px solid var(--line); }
td.first { text-align: left; }
td.why { color: var(--quiet); max-width: 60ch; white-space: normal; }
tr.family th, tr.family td { background: var(--panel); font-weight: 600; text-align: left; }
.badge { font-weight: 600; color: var(--unknown); }
.badge.same { color: var(--same); font-weight: 400; }
.badge.slower { color: var(--slower); }
.badge.faster, .badge.mended { color: var(--faster); }
.badge.wrong, .badge.wrong-in-both, td.wrong { color: var(--wrong); }
svg { display: block; }
svg line.base { stroke: var(--quiet); }
svg line.common { stroke: var(--quiet); stroke-dasharray: 2 2; opacity: 0.7; }
svg line.margin { stroke-width: 2.5; stroke-linecap: round; stroke: var(--same); opacity: 0.6; }
svg circle { fill: var(--same); }
svg polyline { fill: none; stroke: var(--same); stroke-width: 1.5; }
svg .slower line.margin { stroke: var(--slower); }
svg .slower circle { fill: var(--slower); }
svg .faster line.margin { stroke: var(--faster); }
svg .faster circle { fill: var(--faster); }
"""
