#include "spin.h"

#include <pthread.h>
#include <time.h>

/* PyPI's librcl is linked to what converts messages for Python, whose data must be there. */
void *PyExc_RuntimeError;
char _Py_TrueStruct[64], _Py_FalseStruct[64], _Py_NoneStruct[64];

static pthread_mutex_t mutex = PTHREAD_MUTEX_INITIALIZER;
static pthread_cond_t turned = PTHREAD_COND_INITIALIZER;

/* Put all that does not run into the wait set. */
static void fill(struct spin *spin) {
  size_t number[KINDS] = {0};
  for (struct work *one = spin->all; one; one = one->next) number[one->kind]++;
  CHECK(rcl_wait_set_resize(&spin->set, number[SUBSCRIPTION], 1, number[TIMER], number[CLIENT],
                            number[SERVICE], 0));
  CHECK(rcl_wait_set_clear(&spin->set));
  CHECK(rcl_wait_set_add_guard_condition(&spin->set, &spin->changed, NULL));
  for (struct work *one = spin->all; one; one = one->next) {
    if (one->busy) continue;
    if (one->kind == SUBSCRIPTION) CHECK(rcl_wait_set_add_subscription(&spin->set, one->of, &one->at));
    if (one->kind == SERVICE) CHECK(rcl_wait_set_add_service(&spin->set, one->of, &one->at));
    if (one->kind == CLIENT) CHECK(rcl_wait_set_add_client(&spin->set, one->of, &one->at));
    if (one->kind == TIMER) CHECK(rcl_wait_set_add_timer(&spin->set, one->of, &one->at));
  }
}

/* List what is ready. */
static void collect(struct spin *spin) {
  const rcl_wait_set_t *set = &spin->set;
  const void *const *found[KINDS] = {
      [SUBSCRIPTION] = (const void *const *)set->subscriptions,
      [SERVICE] = (const void *const *)set->services,
      [CLIENT] = (const void *const *)set->clients,
      [TIMER] = (const void *const *)set->timers,
  };
  struct work **last = &spin->ready;
  for (struct work *one = spin->all; one; one = one->next) {
    if (one->busy || found[one->kind][one->at] != one->of) continue;
    one->busy = true;
    one->next_ready = NULL;
    *last = one;
    last = &one->next_ready;
  }
}

static void wait_once(struct spin *spin) {
  fill(spin);
  spin->is_waited = true;
  pthread_mutex_unlock(&mutex);
  rcl_ret_t answer = rcl_wait(&spin->set, RCL_MS_TO_NS(10000));
  if (answer != RCL_RET_TIMEOUT) CHECK(answer);
  pthread_mutex_lock(&mutex);
  spin->is_waited = false;
  if (answer == RCL_RET_OK) collect(spin);
  pthread_cond_broadcast(&turned);
}

/* Run the next part that is ready. */
static void run_next(struct spin *spin) {
  struct work *one = spin->ready;
  spin->ready = one->next_ready;
  pthread_mutex_unlock(&mutex);
  if (one->kind != TIMER || rcl_timer_call(one->of) == RCL_RET_OK) one->run(one->with);
  rcl_reset_error();
  pthread_mutex_lock(&mutex);
  one->busy = false;
  CHECK(rcl_trigger_guard_condition(&spin->changed)); /* it is to be waited for again */
  pthread_cond_broadcast(&turned);
}

static void *run(void *of) {
  struct spin *spin = of;
  pthread_mutex_lock(&mutex);
  for (;;) {
    if (spin->ready)
      run_next(spin);
    else if (spin->is_waited || spin->changing)
      pthread_cond_wait(&turned, &mutex);
    else
      wait_once(spin);
  }
  return NULL;
}

static void on_arrival(const void *of, size_t number) {
  struct work *work = (struct work *)of;
  pthread_mutex_lock(&mutex);
  work->arrived += number;
  pthread_cond_broadcast(&turned);
  pthread_mutex_unlock(&mutex);
}

static void *run_events(void *of) {
  struct spin *spin = of;
  pthread_mutex_lock(&mutex);
  for (;;) {
    struct work *one = spin->all;
    while (one && !one->arrived) one = one->next;
    if (!one) {
      pthread_cond_wait(&turned, &mutex);
      continue;
    }
    one->arrived--;
    pthread_mutex_unlock(&mutex);
    one->run(one->with);
    rcl_reset_error();
    pthread_mutex_lock(&mutex);
  }
  return NULL;
}

static void *run_timer(void *of) {
  struct work *work = of;
  int64_t left;
  for (;;) {
    CHECK(rcl_timer_get_time_until_next_call(work->of, &left));
    if (left > 0) nanosleep(&(struct timespec){left / 1000000000, left % 1000000000}, NULL);
    if (left <= 0 && rcl_timer_call(work->of) == RCL_RET_OK) work->run(work->with);
  }
  return NULL;
}

static void start(void *(*what)(void *), void *with) {
  pthread_t thread;
  pthread_create(&thread, NULL, what, with);
  pthread_detach(thread);
}

static void add_events(struct spin *spin, struct work *work) {
  pthread_mutex_lock(&mutex);
  work->next = spin->all;
  spin->all = work;
  pthread_mutex_unlock(&mutex);
  if (work->kind == SUBSCRIPTION)
    CHECK(rcl_subscription_set_on_new_message_callback(work->of, on_arrival, work));
  if (work->kind == SERVICE) CHECK(rcl_service_set_on_new_request_callback(work->of, on_arrival, work));
  if (work->kind == CLIENT) CHECK(rcl_client_set_on_new_response_callback(work->of, on_arrival, work));
  if (work->kind == TIMER) start(run_timer, work);
}

void spin_start(struct spin *spin, int threads) {
  rcl_allocator_t allocator = rcl_get_default_allocator();
  rcl_init_options_t options = rcl_get_zero_initialized_init_options();
  CHECK(rcl_init_options_init(&options, allocator));
  spin->context = rcl_get_zero_initialized_context();
  CHECK(rcl_init(0, NULL, &options, &spin->context));
  CHECK(rcl_init_options_fini(&options));
  CHECK(rcl_steady_clock_init(&spin->clock, &allocator));
  spin->changed = rcl_get_zero_initialized_guard_condition();
  CHECK(rcl_guard_condition_init(&spin->changed, &spin->context,
                                 rcl_guard_condition_get_default_options()));
  spin->set = rcl_get_zero_initialized_wait_set();
  CHECK(rcl_wait_set_init(&spin->set, 0, 1, 0, 0, 0, 0, &spin->context, allocator));
  if (getenv("EVENTS")) threads = 1;
  for (int i = 0; i < threads; i++) start(getenv("EVENTS") ? run_events : run, spin);
}

/* Let no thread wait while parts come and go. */
static void begin_change(struct spin *spin) {
  pthread_mutex_lock(&mutex);
  spin->changing++;
  CHECK(rcl_trigger_guard_condition(&spin->changed));
  while (spin->is_waited) pthread_cond_wait(&turned, &mutex);
}

static void end_change(struct spin *spin) {
  spin->changing--;
  pthread_cond_broadcast(&turned);
  pthread_mutex_unlock(&mutex);
}

void spin_add(struct spin *spin, struct work *work) {
  if (getenv("EVENTS")) {
    add_events(spin, work);
    return;
  }
  begin_change(spin);
  work->next = spin->all;
  spin->all = work;
  end_change(spin);
}

void spin_remove(struct spin *spin, struct work *work) {
  begin_change(spin);
  struct work **at = &spin->all, **ready = &spin->ready;
  while (*at != work) at = &(*at)->next;
  *at = work->next;
  while (*ready && *ready != work) ready = &(*ready)->next_ready;
  if (*ready)
    *ready = work->next_ready;
  else
    while (work->busy) pthread_cond_wait(&turned, &mutex);
  end_change(spin);
}

void make_node(struct spin *spin, rcl_node_t *node, const char *name, const char *space) {
  rcl_node_options_t options = rcl_node_get_default_options();
  *node = rcl_get_zero_initialized_node();
  CHECK(rcl_node_init(node, name, space, &spin->context, &options));
  CHECK(rcl_node_options_fini(&options));
}

void make_timer(struct spin *spin, rcl_timer_t *timer, double seconds) {
  *timer = rcl_get_zero_initialized_timer();
  CHECK(rcl_timer_init2(timer, &spin->clock, &spin->context, (int64_t)(seconds * 1e9), NULL,
                        rcl_get_default_allocator(), true));
}
