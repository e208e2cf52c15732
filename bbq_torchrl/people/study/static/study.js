"use strict";
// A form is sent once: the nonce makes a second one harmless, this makes it unlikely.
for (const form of document.forms) {
  form.addEventListener("submit", (event) => {
    if (form.dataset.sent) event.preventDefault();
    form.dataset.sent = "yes";
  });
}
// A page that the back button brings out of the cache can send again.
window.addEventListener("pageshow", (event) => {
  if (event.persisted) window.location.reload();
});
