/* A program with one component that it is linked to (main), or a container that loads them:
 * main [PATH[=NAME]]...; then each line of its input is "load PATH[=NAME]", "unload PATH[=NAME]",
 * "renew PATH[=NAME]" (both, for ever), "run PROGRAM" (beside it) or "become PROGRAM". */
#include "spin.h"

#include <dlfcn.h>
#include <fcntl.h>
#include <spawn.h>
#include <unistd.h>

extern char **environ;
void *component_begin(struct spin *spin, const char *name) __attribute__((weak));

struct loaded { char what[512]; void *library, *component; struct loaded *next; };
static struct loaded *all;

static void load(struct spin *spin, const char *what) {
  struct loaded *new = calloc(1, sizeof *new);
  snprintf(new->what, sizeof new->what, "%s", what);
  char path[512], *name;
  strcpy(path, new->what);
  if ((name = strchr(path, '='))) *name++ = 0;
  new->library = dlopen(path, RTLD_LAZY);
  if (!new->library) fprintf(stderr, "%s\n", dlerror()), exit(1);
  __typeof__(&component_begin) begin = (__typeof__(&component_begin))dlsym(new->library, "component_begin");
  new->component = begin(spin, name ? name : "");
  new->next = all;
  all = new;
}

static void unload(const char *what) {
  struct loaded **at = &all, *one;
  while (*at && strcmp((*at)->what, what)) at = &(*at)->next;
  if (!(one = *at)) fprintf(stderr, "%s is not loaded\n", what), exit(1);
  *at = one->next;
  __typeof__(&component_end) end = (__typeof__(&component_end))dlsym(one->library, "component_end");
  end(one->component);
  dlclose(one->library);
  free(one);
}

int main(int argc, char **argv) {
  static struct spin spin;
  spin_start(&spin, 3);
  if (argc == 1 && component_begin) component_begin(&spin, "");
  for (int i = 1; i < argc; i++) load(&spin, argv[i]);
  char line[1024];
  while (fgets(line, sizeof line, stdin)) {
    line[strcspn(line, "\n")] = 0;
    char *word = strchr(line, ' ');
    if (word) *word++ = 0;
    if (!word) continue;
    while (!strcmp(line, "renew")) {
      unload(word);
      usleep(100000);
      load(&spin, word);
      usleep(100000);
    }
    pid_t child;
    char *const words[] = {word, NULL};
    if (!strcmp(line, "load")) load(&spin, word);
    if (!strcmp(line, "unload")) unload(word);
    posix_spawn_file_actions_t quiet; /* the lines are for this process */
    posix_spawn_file_actions_init(&quiet);
    posix_spawn_file_actions_addopen(&quiet, 0, "/dev/null", O_RDONLY, 0);
    if (!strcmp(line, "run")) posix_spawn(&child, word, &quiet, NULL, words, environ);
    posix_spawn_file_actions_destroy(&quiet);
    if (!strcmp(line, "become")) execv(word, words), perror(word);
    printf("done\n");
    fflush(stdout);
  }
  for (;;) pause();
}
