/* ros2_work/caller.py in C, without goals: calls without pause, counts, listens, prints for judge.py.
 *
 * Environment: FIRST, the number before that of the first call and message. */
#include "spin.h"

#include <rcl_interfaces/srv/get_parameters.h>
#include <rosidl_runtime_c/string_functions.h>
#include <std_msgs/msg/int64.h>
#include <std_msgs/msg/string.h>
#include <stdarg.h>
#include <time.h>
#include <unistd.h>

#define PERIOD 0.01
#define CALL 20.0 /* seconds until a call counts as lost */

static struct {
  rcl_node_t node;
  rcl_publisher_t counter;
  rcl_subscription_t chatter, map;
  rcl_client_t client;
  rcl_timer_t asks, counts;
  long number, call;
  int64_t open; /* the request that is not answered, 0 for none */
  double since;
} own;

static double now(clockid_t which) {
  struct timespec at;
  clock_gettime(which, &at);
  return (double)at.tv_sec + (double)at.tv_nsec / 1e9;
}

static void report(const char *words, ...) {
  char text[256], line[512];
  va_list more;
  va_start(more, words);
  vsnprintf(text, sizeof text, words, more);
  va_end(more);
  int length = snprintf(line, sizeof line, "%.4f %s\n", now(CLOCK_REALTIME), text);
  if (write(1, line, (size_t)length) < 0) exit(1);
}

static void hear(rcl_subscription_t *from, const char *kind) {
  std_msgs__msg__String message;
  std_msgs__msg__String__init(&message);
  if (rcl_take(from, &message, NULL, NULL) == RCL_RET_OK) report("%s %s", kind, message.data.data);
  std_msgs__msg__String__fini(&message);
}
static void hear_chatter(void *unused) { (void)unused; hear(&own.chatter, "chat"); }
static void hear_map(void *unused) { (void)unused; hear(&own.map, "map"); }

static void count(void *unused) {
  std_msgs__msg__Int64 message = {++own.number};
  (void)unused;
  CHECK(rcl_publish(&own.counter, &message, NULL));
}

/* Call again as soon as the last call was answered, or is lost. */
static void ask(void *unused) {
  bool there = false;
  char text[32];
  (void)unused;
  if (own.open && now(CLOCK_MONOTONIC) < own.since + CALL) return;
  if (own.open) report("call %ld lost", own.call);
  own.open = 0;
  if (rcl_service_server_is_available(&own.node, &own.client, &there) != RCL_RET_OK || !there) return;
  rcl_interfaces__srv__GetParameters_Request request;
  rcl_interfaces__srv__GetParameters_Request__init(&request);
  snprintf(text, sizeof text, "%ld", ++own.call);
  rosidl_runtime_c__String__Sequence__init(&request.names, 1);
  rosidl_runtime_c__String__assign(&request.names.data[0], text);
  own.since = now(CLOCK_MONOTONIC);
  CHECK(rcl_send_request(&own.client, &request, &own.open));
  rcl_interfaces__srv__GetParameters_Request__fini(&request);
}

static void be_answered(void *unused) {
  rmw_request_id_t id;
  rcl_interfaces__srv__GetParameters_Response response;
  (void)unused;
  rcl_interfaces__srv__GetParameters_Response__init(&response);
  if (rcl_take_response(&own.client, &id, &response) == RCL_RET_OK && id.sequence_number == own.open) {
    const char *version = response.values.data[0].string_value.data;
    report("call %ld %s %.1f", own.call, version, (now(CLOCK_MONOTONIC) - own.since) * 1000);
    own.open = 0;
  }
  rcl_interfaces__srv__GetParameters_Response__fini(&response);
}

/* One thread runs all: the parts share `own`. */
static void (*const runs[])(void *) = {hear_chatter, hear_map, be_answered, ask, count};
static void *const parts[] = {&own.chatter, &own.map, &own.client, &own.asks, &own.counts};
static const enum kind kinds[] = {SUBSCRIPTION, SUBSCRIPTION, CLIENT, TIMER, TIMER};

int main(void) {
  static struct spin spin;
  static struct work works[5];
  const rosidl_message_type_support_t *text = ROSIDL_GET_MSG_TYPE_SUPPORT(std_msgs, msg, String);
  const char *first = getenv("FIRST");
  own.number = own.call = first ? atol(first) : 0;
  spin_start(&spin, 1);
  make_node(&spin, &own.node, "caller_in_c", "/");
  MAKE(subscription, &own.chatter, &own.node, text, "chatter", options.qos.depth = 1000);
  MAKE(subscription, &own.map, &own.node, text, "map", LATCHED);
  MAKE(publisher, &own.counter, &own.node, ROSIDL_GET_MSG_TYPE_SUPPORT(std_msgs, msg, Int64), "counter",
       options.qos.depth = 1000);
  MAKE(client, &own.client, &own.node,
       ROSIDL_GET_SRV_TYPE_SUPPORT(rcl_interfaces, srv, GetParameters), "work", );
  make_timer(&spin, &own.asks, PERIOD);
  make_timer(&spin, &own.counts, PERIOD);
  for (int i = 0; i < 5; i++) {
    works[i] = (struct work){runs[i], NULL, parts[i], kinds[i], 0, false, 0, NULL, NULL};
    spin_add(&spin, &works[i]);
  }
  for (;;) pause();
}
