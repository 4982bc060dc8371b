export default {
  compilerOptions: {
    runes: true,
    css: "external",
    // Regions that scroll have to be reached by keyboard; axe-core, which the browser tests run, insists on it.
    warningFilter: (warning) => warning.code !== "a11y_no_noninteractive_tabindex",
  },
};
