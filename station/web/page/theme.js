// Runs before the first paint, so that a page in a dark hall never flashes white. Not a module for that reason.
"use strict";
{
  const stored = () => { try { return localStorage.getItem("theme"); } catch { return null; } };
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const apply = () => {
    const chosen = stored();
    const theme = chosen === "light" || chosen === "dark" ? chosen : dark.matches ? "dark" : "light";
    if (document.documentElement.dataset.theme === theme) return;
    document.documentElement.dataset.theme = theme;
    document.dispatchEvent(new CustomEvent("theme"));
  };
  apply();
  dark.addEventListener("change", apply);
  document.addEventListener("DOMContentLoaded", () => {
    const button = document.getElementById("theme");
    const name = () => {
      const other = document.documentElement.dataset.theme === "dark" ? "light" : "dark";
      button.textContent = other;
      button.setAttribute("aria-label", `Use the ${other} theme`);
    };
    name();
    document.addEventListener("theme", name);
    button.addEventListener("click", () => {
      const other = document.documentElement.dataset.theme === "dark" ? "light" : "dark";
      try { localStorage.setItem("theme", other); } catch { /* a page without storage keeps it until it is closed */ }
      document.documentElement.dataset.theme = other;
      document.dispatchEvent(new CustomEvent("theme"));
    });
  });
}
