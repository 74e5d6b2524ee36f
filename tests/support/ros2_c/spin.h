/* An executor on rcl, as client libraries of C and C++ have one: threads wait in turn with one wait
 * set, and run what is ready. Each part runs in one thread at a time. With EVENTS in the environment
 * one thread is called when something arrives, and another one for each timer; no part is removed. */
#ifndef SPIN_H
#define SPIN_H

#include <rcl/error_handling.h>
#include <rcl/graph.h>
#include <rcl/rcl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum kind { SUBSCRIPTION, SERVICE, CLIENT, TIMER, KINDS };
struct work {
  void (*run)(void *with);
  void *with, *of; /* of: the part of rcl */
  enum kind kind;
  size_t at; /* its place in the wait set */
  bool busy;
  size_t arrived; /* with EVENTS: what it was not run for */
  struct work *next, *next_ready;
};
struct spin {
  rcl_context_t context;
  rcl_clock_t clock;
  rcl_guard_condition_t changed;
  rcl_wait_set_t set;
  struct work *all, *ready;
  bool is_waited, ends;
  int changing;
};

/* Starts threads that never end. */
void spin_start(struct spin *spin, int threads);
void spin_add(struct spin *spin, struct work *work);
/* Returns when the part does not run any more, and will not. */
void spin_remove(struct spin *spin, struct work *work);

/* What a component has: `name` is its namespace, "" for none. */
void *component_begin(struct spin *spin, const char *name);
void component_end(void *component);

#define CHECK(call)                                                                        \
  do {                                                                                     \
    if ((call) != RCL_RET_OK) {                                                            \
      fprintf(stderr, "%s:%d: %s: %s\n", __FILE__, __LINE__, #call, rcl_get_error_string().str); \
      exit(1);                                                                             \
    }                                                                                      \
  } while (0)

/* rcl's words for a part that is made with other than the default options. */
#define MAKE(kind, part, node, type, name, change)                          \
  do {                                                                      \
    rcl_##kind##_options_t options = rcl_##kind##_get_default_options();    \
    change;                                                                 \
    *(part) = rcl_get_zero_initialized_##kind();                            \
    CHECK(rcl_##kind##_init((part), (node), (type), (name), &options));     \
  } while (0)
#define LATCHED                                                   \
  options.qos.depth = 1;                                          \
  options.qos.durability = RMW_QOS_POLICY_DURABILITY_TRANSIENT_LOCAL

void make_node(struct spin *spin, rcl_node_t *node, const char *name, const char *space);
void make_timer(struct spin *spin, rcl_timer_t *timer, double seconds);

#endif
