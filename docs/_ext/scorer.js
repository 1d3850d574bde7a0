// Sphinx's scores, except for names of the code, which are listed after all pages.
var Scorer = {
  objNameMatch: -10,
  objPartialMatch: -20,
  objPrio: {},
  objPrioDefault: -100,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};
