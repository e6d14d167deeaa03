//! Colours and type of the page, in light and dark.

/// The style sheet.
pub(super) const CSS: &str = "
:root{--page:#fcfcfb;--ink:#0b0b0b;--soft:#52514e;--grid:#e1e0d9;--axis:#a9a79e;--row:#f3f2ee;
--s0:#2a78d6;--s1:#d9631e;--s2:#6a58c4;--s3:#1b8f63}
@media (prefers-color-scheme:dark){:root{--page:#1a1a19;--ink:#fff;--soft:#c3c2b7;--grid:#2c2c2a;
--axis:#6b6a64;--row:#242423;--s0:#4a94ea;--s1:#e8763a;--s2:#9c8ff0;--s3:#2fb583}}
*{box-sizing:border-box}
body{margin:0;background:var(--page);color:var(--ink);font:15px/1.5 system-ui,sans-serif}
main{max-width:1320px;margin:0 auto;padding:24px 16px 64px}
h1{font-size:24px;margin:0 0 8px}h2{font-size:19px;margin:40px 0 8px}h3{font-size:15px;margin:24px 0 4px}
p{margin:8px 0;color:var(--soft);max-width:85ch}
.charts{display:grid;grid-template-columns:repeat(auto-fill,minmax(min(100%,500px),1fr));gap:16px 24px}
figure{margin:0}figcaption{font-size:13px;font-weight:600;margin:4px 0}
svg{display:block;width:100%;height:auto}
svg text{font:11px system-ui,sans-serif;fill:var(--soft)}
.grid{stroke:var(--grid);stroke-width:1}.axis{stroke:var(--axis);stroke-width:1}
.s0{--c:var(--s0)}.s1{--c:var(--s1)}.s2{--c:var(--s2)}.s3{--c:var(--s3)}
.box{fill:var(--c)}.whisker{stroke:var(--c);stroke-width:2}
.median{stroke:var(--page);stroke-width:2}
.mean{fill:var(--page);stroke:var(--c);stroke-width:1.5}
.line{fill:none;stroke:var(--c);stroke-width:2;stroke-linejoin:round}
.band{fill:var(--c);opacity:.15}
.legend{display:flex;flex-wrap:wrap;gap:4px 20px;color:var(--ink)}
.legend .note{color:var(--soft)}
.key{display:inline-block;width:12px;height:12px;border-radius:3px;background:var(--c);margin-right:6px}
.wide{overflow-x:auto}
table{border-collapse:collapse;font-size:13px;font-variant-numeric:tabular-nums;min-width:100%}
th,td{padding:4px 8px;text-align:right;white-space:nowrap;border-bottom:1px solid var(--grid)}
th{font-weight:600;vertical-align:bottom}
tbody tr:hover{background:var(--row)}
.text{text-align:left}
.long{white-space:normal;min-width:24em}
";
