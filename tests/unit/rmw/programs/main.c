/* A node as tests drive it: one command a line, one answer a line. The client library that it loads
 * is loaded as Python loads ROS, with local scope, unless it is linked (LINKED). */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>

int client_main(void);

int main(int count, char **words) {
#ifdef LINKED
  (void)count, (void)words;
  return client_main();
#else
  void *client = count > 1 ? dlopen(words[1], RTLD_NOW | RTLD_LOCAL) : NULL;
  if (!client) return fprintf(stderr, "%s\n", dlerror()), 1;
  return ((int (*)(void))dlsym(client, "client_main"))();
#endif
}
